# SPDX-License-Identifier: Apache-2.0
"""What is said about a recording, and about one whose files are not whole."""

from collections.abc import Callable
from typing import Any

from hueflight.recording.inspection import describe_recording

Make = Callable[..., Any]


def test_a_recording_is_described_without_being_read(recorded: Make) -> None:
    path, _ = recorded(metadata={"target": "brick"})
    found = describe_recording(path)
    assert found.kind == "recording of packets"
    assert (found.facts["frames"], found.facts["ended"]) == (50, True)
    assert found.facts["metadata"] == {"target": "brick"}
    assert found.whole is None


def test_whole_files_are_compared_with_their_checksums(recorded: Make) -> None:
    path, _ = recorded()
    found = describe_recording(path, check=True)
    assert found.whole
    assert "compared with their checksums" in found.evidence


def test_a_damaged_file_is_told_with_what_to_do(recorded: Make) -> None:
    path, packets = recorded()
    octets = bytearray(path.read_bytes())
    octets[octets.index(packets[20]) + 100] ^= 1
    path.write_bytes(octets)
    found = describe_recording(path, check=True)
    assert found.whole is False
    assert "bytes belong to no intact record" in found.evidence
    assert "hueflight recover saves what is intact" in found.evidence
