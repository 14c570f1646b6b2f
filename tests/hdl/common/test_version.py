# SPDX-License-Identifier: Apache-2.0
"""The hash of the sources changes with the gateware, and with nothing else."""

from pathlib import Path

import pytest

from hueflight_hdl.common.version import hash_of_sources


@pytest.mark.parametrize(
    ("name", "text", "same"),
    [
        ("a.py", b"# a comment\n\nx = 1\n", True),
        ("a.py", b"x = 1  # why\n", False),
        ("a.py", b"x = 2\n", False),
        ("a.py", b"x =1\n", False),
        ("b.py", b"x = 1\n", False),
    ],
)
def test_only_code_counts(tmp_path: Path, name: str, text: bytes, same: bool):
    before, after = tmp_path / "before", tmp_path / "after"
    for folder, file, content in ((before, "a.py", b"x = 1\n"), (after, name, text)):
        folder.mkdir()
        (folder / file).write_bytes(content)
    assert (hash_of_sources(before) == hash_of_sources(after)) is same
