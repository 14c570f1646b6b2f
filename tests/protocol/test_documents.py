# SPDX-License-Identifier: Apache-2.0
"""The documents say what the declarations say, and their examples are true."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

import hueflight_protocol as hp
from hueflight_protocol import control

ROOT = Path(__file__).resolve().parents[2]
PROTOCOL = (ROOT / "docs" / "protocol.md").read_text()


def test_generated_parts_are_current(tmp_path: Path):
    shutil.copy(ROOT / "docs" / "protocol.md", tmp_path)
    subprocess.run([sys.executable, ROOT / "tools" / "protocol_docs.py", tmp_path], check=True)
    for name in ("protocol.md", "registers.md"):
        current = (ROOT / "docs" / name).read_text()
        assert (tmp_path / name).read_text() == current, "run tools/protocol_docs.py"


def hex_lines(section: str, pattern: str) -> bytes:
    text = PROTOCOL.split(section)[1].split("```text")[1].split("```")[0]
    return bytes.fromhex(" ".join(re.findall(pattern, text, flags=re.MULTILINE)))


def test_the_frame_example_decodes_to_what_its_text_says():
    packet = hex_lines("generated: example", r"^ *\d+  ((?:[0-9a-f]{2} )+)")
    frame = hp.decode_frame(packet)
    codes = np.zeros(20, int)
    codes[[1, 4, 15, 16, 17, 18]] = 0x1FF, 3, 1, 2, 3, 4
    np.testing.assert_array_equal(frame.codes, codes.reshape(4, 5))
    assert (frame.header.sequence, frame.header.run, frame.header.periods) == (5, 16, 3125)


def test_the_message_example_is_the_write_it_says():
    message = hex_lines("generated: message example", r"^message  (.*)$")
    frame = hex_lines("generated: message example", r"^frame    (.*)$")
    assert hp.decode_request(message) == control.write(1, 0x104, [0x0008_0018])
    assert frame == hp.serial_frame(message)
    assert hp.illuminator_map()["pulse"].address_of(0, 1, 0) == 0x104


def test_every_rule_that_the_code_names_is_in_the_document():
    stated = set(re.findall(r"^\*\*([PFESBCG]\d+)\*\*", PROTOCOL, flags=re.MULTILINE))
    sources = "".join(
        path.read_text() for path in (ROOT / "protocol" / "hueflight_protocol").glob("*.py")
    )
    named = set(re.findall(r'rule="([A-Z]\d+)"', sources)) | set(
        re.findall(r'"([PFESBCG]\d+)"', sources)
    )
    assert len(named) > 20
    assert named <= stated


def test_numbers_in_the_text():
    # "For 512 pixels of 9 bits it is 452"; "No packet is longer than 2 162 768 bytes".
    from hueflight_protocol.wire import dense_from

    assert f"it is {dense_from(512, 9)}" in PROTOCOL
    assert f"{hp.MAX_PACKET_BYTES:,}".replace(",", " ") in PROTOCOL
    assert f"**0x{hp.crc32c(b'123456789'):08X}**" in PROTOCOL
    assert f"12 to {control.MAX_MESSAGE_BYTES} bytes" in PROTOCOL
    assert f"at most {control.MAX_COBS_BYTES} bytes" in PROTOCOL
