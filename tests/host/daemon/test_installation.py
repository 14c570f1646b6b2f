# SPDX-License-Identifier: Apache-2.0
"""The udev rules and the systemd unit, checked by the tools that will read them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hueflight.acquisition.thread_priority import ThreadPriority
from hueflight.devices.camera import MAX_TRANSFER_BYTES
from hueflight.devices.transports.usb_identity import PRODUCT_ID, PRODUCT_PREFIX, VENDOR_ID
from hueflight.devices.transports.usb_stream import TRANSFERS, USBFS_LIMIT

HOST = Path(__file__).resolve().parents[3] / "host"
RULES = HOST / "udev/60-hueflight.rules"
UNIT = HOST / "systemd/hueflight@.service"
MEMORY = HOST / "systemd/tmpfiles-hueflight.conf"
# keys and operators of udev(7) that these rules use
MATCH = re.compile(r'(SUBSYSTEM|ENV\{\w+\}|ATTR\{\w+\}|ATTRS\{\w+\})=="([^"]+)"')
ASSIGN = re.compile(r'(MODE|GROUP|ENV\{\w+\})="([^"]+)"|(TAG|SYMLINK)\+="([^"]+)"')


def rules() -> list[tuple[dict[str, str], list[str]]]:
    """Matches and assignments of each rule."""
    found = []
    for line in RULES.read_text().splitlines():
        if not line or line.startswith("#"):
            continue
        matches, assigned = {}, []
        for part in re.findall(r'[^,"]+"[^"]*"', line):
            part = part.strip()
            if match := MATCH.fullmatch(part):
                assert not assigned, f"a match after an assignment: {part}"
                matches[match[1]] = match[2]
            else:
                assert ASSIGN.fullmatch(part), f"no rule of udev(7): {part!r}"
                assigned.append(part)
        found.append((matches, assigned))
    return found


def test_rules_are_of_the_camera_that_the_driver_looks_for() -> None:
    (camera, opened), (illuminator, line) = rules()
    assert camera["ATTR{idVendor}"] == f"{VENDOR_ID:04x}"
    assert camera["ATTR{idProduct}"] == f"{PRODUCT_ID:04x}"
    assert camera["ATTR{product}"] == f"{PRODUCT_PREFIX}*"
    assert illuminator["SUBSYSTEM"] == "tty"
    for assigned in (opened, line):
        assert 'TAG+="uaccess"' in assigned
        assert 'MODE="0660"' in assigned
    assert 'ENV{ID_MM_DEVICE_IGNORE}="1"' in line
    # the tag is turned into permissions there (systemd: rules.d/73-seat-late.rules)
    assert RULES.name < "73-seat-late.rules"


def test_udev_reads_the_rules() -> None:
    udevadm = shutil.which("udevadm")
    if udevadm is None:
        pytest.skip("udevadm is not installed")
    version = subprocess.run([udevadm, "--version"], capture_output=True, text=True, timeout=20)
    if int(version.stdout) < 254:
        pytest.skip(f"udevadm {version.stdout.strip()} has no verify: it came with 254")
    done = subprocess.run(
        [udevadm, "verify", "--no-style", str(RULES)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_unit_lets_acquisition_come_first() -> None:
    limits = dict(re.findall(r"^(Limit\w+)=(\S+)$", UNIT.read_text(), re.M))
    assert int(limits["LimitRTPRIO"]) == max(priority.real_time for priority in ThreadPriority)
    assert int(limits["LimitNICE"]) == min(priority.niceness for priority in ThreadPriority)


def test_the_kernel_is_asked_for_memory_where_the_driver_looks() -> None:
    lines = [line for line in MEMORY.read_text().splitlines() if not line.startswith("#")]
    [(kind, path, *unused, megabytes)] = [line.split() for line in lines]
    assert (kind, path, unused) == ("w", str(USBFS_LIMIT), ["-"] * 4)  # tmpfiles.d(5)
    assert int(megabytes) << 20 >= 2 * TRANSFERS * MAX_TRANSFER_BYTES


def test_systemd_reads_the_unit(tmp_path: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    text = UNIT.read_text()
    assert "/opt/hueflight/bin/hueflight serve" in text
    copy = tmp_path / UNIT.name
    # the program must exist for the check; all else stays
    copy.write_text(text.replace("/opt/hueflight/bin/hueflight", sys.executable))
    done = subprocess.run(
        [analyze, "verify", "--man=no", "--recursive-errors=no", str(copy)],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert UNIT.name.partition(".")[0] not in done.stderr, done.stderr
    copy.write_text(copy.read_text().replace("Restart=on-failure", "Restart=whenever"))
    spoiled = subprocess.run(
        [analyze, "verify", "--man=no", "--recursive-errors=no", str(copy)],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert "whenever" in spoiled.stderr  # the check does look at it


def test_the_unit_confines_the_daemon() -> None:
    """The exposure that systemd computes is at most 3 of 10; without its restrictions it is not."""
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    command = [analyze, "security", "--offline=true", "--threshold=30", "--no-pager"]
    done = subprocess.run([*command, str(UNIT)], capture_output=True, text=True, timeout=60)
    if "unrecognized option" in done.stderr:
        pytest.skip("systemd-analyze is not installed in a version with offline security")
    assert done.returncode == 0, done.stdout[-300:]
    assert "Overall exposure level" in done.stdout


def test_systemd_waits_for_the_daemon_and_watches_it() -> None:
    """The daemon speaks sd_notify; the watchdog's patience is longer than one step of a run."""
    from hueflight.acquisition.runner import PATIENCE_S
    from hueflight.acquisition.states import State

    found = dict(re.findall(r"^(\w+)=(\S+)$", UNIT.read_text(), re.M))
    assert found["Type"] == "notify"
    assert int(found["WatchdogSec"]) > PATIENCE_S[State.RUNNING]
