"""Version of the gateware, and a hash of its sources."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import hueflight_protocol

VERSION = (0, 1, 0)


@cache
def source_hash() -> int:
    """Return the first 32 bits of the SHA-256 of the gateware and protocol sources."""
    digest = hashlib.sha256()
    for root in (Path(__file__).parent.parent, Path(hueflight_protocol.__file__).parent):
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0")
            digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:4], "big")
