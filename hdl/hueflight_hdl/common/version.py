# SPDX-License-Identifier: Apache-2.0
"""Version of the gateware, and a hash of its sources."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import hueflight_protocol

VERSION = (0, 1, 0)


@cache
def source_hash() -> int:
    """Return a hash of the gateware and protocol sources, as IDENTIFY reports it."""
    return hash_of_sources(Path(__file__).parent.parent, Path(hueflight_protocol.__file__).parent)


def hash_of_sources(*folders: Path) -> int:
    """Return the first 32 bits of the SHA-256 of the Python files in some folders.

    Empty lines and lines that hold only a comment do not count: they leave a bitstream as it is.
    """
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0")
            for line in path.read_bytes().splitlines():
                if line.strip() and not line.lstrip().startswith(b"#"):
                    digest.update(line + b"\n")
    return int.from_bytes(digest.digest()[:4], "big")
