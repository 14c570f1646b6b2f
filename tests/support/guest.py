# SPDX-License-Identifier: Apache-2.0
"""A machine with a real Linux kernel in QEMU, whose USB cable ends in the emulated camera.

No virtualisation is needed: QEMU interprets. The guest sees this machine's files, read-only, and
runs this Python on them; what it prints comes over the serial line.
"""

from __future__ import annotations

import contextlib
import gzip
import json
import os
import shutil
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from support.emulated_camera import EmulatedCamera
from support.lines import Lines
from support.usbredir import UsbRedir

KERNEL_ROOT = "HUEFLIGHT_GUEST_KERNEL"  #: folder where a kernel package is unpacked; default /
PATIENCE_S = 220.0
END_S = 20.0
MODULES = (
    "virtio_ring", "virtio", "virtio_pci_legacy_dev", "virtio_pci_modern_dev", "virtio_pci",
    "netfs", "fscache", "9pnet", "9pnet_virtio", "9p",
    "usb-common", "usbcore", "xhci-hcd", "xhci-pci",
)  # fmt: skip
INIT = """#!/bin/busybox sh
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t sysfs sys /sys
/bin/busybox mount -t devtmpfs dev /dev
for module in /modules/*.ko; do /bin/busybox insmod $module; done
/bin/busybox mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=loose,ro host /mnt
for folder in proc sys dev; do /bin/busybox mount --bind /$folder /mnt/$folder; done
/bin/busybox mount -t tmpfs run /mnt/run
/bin/busybox ip link set lo up
/bin/busybox chroot /mnt {python} -u {program} 2>&1
/bin/busybox echo "ended with $?"
/bin/busybox poweroff -f
"""
PRELUDE = """
import importlib.util, json, os, sys, time, types
# the driver alone: all of hueflight would take an interpreted processor most of a minute to import
for name in ("hueflight", "hueflight.devices"):
    found = importlib.util.find_spec(name)
    package = types.ModuleType(name)
    package.__path__ = list(found.submodule_search_locations)
    package.__spec__ = found
    sys.modules[name] = package
from hueflight.devices.errors import DeviceGoneError
from hueflight.devices.transports.usb import open_camera
from hueflight.model.instrument import Instrument
from hueflight_protocol import PacketParser
instrument = Instrument.from_json(open({instrument!r}).read())
def say(**values): print("@" + json.dumps(values), flush=True)
def read_all(camera, parser, quiet=2.0):
    since = time.monotonic()
    while time.monotonic() - since < quiet:
        data = camera.read(0.1)
        if data:
            parser.feed(data)
            since = time.monotonic()
"""


@dataclass(frozen=True)
class Kernel:
    """A kernel and its modules as files."""

    image: Path
    modules: Path


def find_kernel() -> Kernel | None:
    """The newest Debian kernel under `KERNEL_ROOT`."""
    root = Path(os.environ.get(KERNEL_ROOT, "/"))
    for image in sorted(root.glob("boot/vmlinuz-*"), reverse=True):
        modules = root / "lib/modules" / image.name.removeprefix("vmlinuz-") / "kernel"
        if modules.is_dir():
            return Kernel(image, modules)
    return None


def require_guest() -> Kernel:
    """What the guest needs; skip, saying so, where it is not there, but never in CI."""
    kernel = find_kernel()
    missing = [
        package
        for package, there in (
            ("qemu-system-x86", shutil.which("qemu-system-x86_64")),
            ("busybox-static", shutil.which("busybox")),
            (f"linux-image-amd64 (or ${KERNEL_ROOT})", kernel),
        )
        if not there
    ]
    if missing or kernel is None:
        pytest.skip(f"a guest with a real kernel needs the packages {', '.join(missing)}")
    return kernel


def initramfs(kernel: Kernel, init: str) -> bytes:
    """The guest's first files: busybox, modules in order, and what to do with them."""
    busybox = shutil.which("busybox")
    assert busybox is not None
    found = {path.name.partition(".ko")[0]: path for path in kernel.modules.rglob("*.ko")}
    files = {"init": init.encode(), "bin/busybox": Path(busybox).read_bytes()}
    for place, name in enumerate(MODULES):
        path = found.get(name) or found.get(name.replace("-", "_"))
        if path is not None:  # else it is built in
            files[f"modules/{place:02d}.ko"] = path.read_bytes()
    entries = [(name, stat.S_IFDIR | 0o755, b"") for name in
               ("bin", "dev", "mnt", "modules", "proc", "sys")]  # fmt: skip
    entries += [(name, stat.S_IFREG | 0o755, data) for name, data in files.items()]
    archive = b"".join(_cpio(*entry, number) for number, entry in enumerate(entries, 1))
    return gzip.compress(archive + _cpio("TRAILER!!!", 0, b"", 0), 1)


def _cpio(name: str, mode: int, data: bytes, number: int) -> bytes:
    """One entry of the newc format (cpio(5)): thirteen fields of eight hexadecimal digits."""
    fields = (number, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields) + name.encode() + b"\0"
    return head + bytes(-len(head) % 4) + data + bytes(-len(data) % 4)


class Guest:
    """A booted machine and its camera."""

    def __init__(self, process: subprocess.Popen[str], cable: UsbRedir) -> None:
        self.cable = cable
        self._lines = Lines(process.stdout)  # pyright: ignore[reportArgumentType]
        self._log: list[str] = []
        self._deadline = time.monotonic() + PATIENCE_S

    def hear(self) -> dict[str, Any]:
        """What the program says next."""
        while True:
            try:
                line = self._lines.next(max(0.1, self._deadline - time.monotonic()))
            except AssertionError as error:
                raise AssertionError(f"{error}; the guest's log:\n{self.log}") from None
            self._log.append(line)
            assert line, f"the guest has ended; its log:\n{self.log}"
            if "@{" in line:
                return json.loads(line[line.index("@{") + 1 :])

    @property
    def log(self) -> str:
        """What has come over the serial line."""
        return "".join(self._log[-60:])


@contextlib.contextmanager
def boot(
    kernel: Kernel, camera: EmulatedCamera, instrument: str, program: str, folder: Path
) -> Iterator[Guest]:
    """Run a program in a guest; the machine is switched off at the end, whatever happens."""
    described, script = folder / "instrument.json", folder / "program.py"
    described.write_text(instrument)
    script.write_text(PRELUDE.format(instrument=str(described)) + program)
    first = folder / "initramfs.gz"
    first.write_bytes(initramfs(kernel, INIT.format(python=sys.executable, program=script)))
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(folder / "usb"))
        listener.listen(1)
        listener.settimeout(END_S)
        process = subprocess.Popen(
            [
                "qemu-system-x86_64", "-accel", "tcg", "-cpu", "max", "-M", "q35", "-m", "1024",
                "-smp", "2", "-nodefaults", "-display", "none", "-no-reboot", "-serial", "stdio",
                "-kernel", str(kernel.image), "-initrd", str(first),
                "-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap",
                "-device", "virtio-9p-pci,fsdev=host,mount_tag=host",
                "-device", "qemu-xhci,id=xhci",
                "-chardev", f"socket,id=cable,path={folder / 'usb'}",
                "-device", "usb-redir,chardev=cable,bus=xhci.0",
                "-append", "console=ttyS0 quiet panic=-1 mitigations=off tsc=reliable",
            ],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            errors="replace",
        )  # fmt: skip
        cable = None
        try:
            sock, _ = listener.accept()
            cable = UsbRedir(camera, sock)
            yield Guest(process, cable)
        finally:
            process.kill()
            process.wait(END_S)
            if cable is not None:
                cable.close()
