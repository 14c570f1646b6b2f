# SPDX-License-Identifier: Apache-2.0
"""Prints a hash of the netlists of all designs.

Two trees with the same hash make the same hardware, but for the hash of the sources that a board
reports, which every change of a source changes. It is run with the package of a mutated tree on the
Python path.
"""

from __future__ import annotations

import hashlib
import tempfile
import warnings
from pathlib import Path

from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.build import prepare
from hueflight_hdl.common import version

TARGETS = (
    ("illuminator", "ulx3s-85f"),
    ("illuminator", "hx8k"),
    ("camera", "ulx3s-85f"),
    ("camera", "ecpix5-85f"),
)


def main() -> None:
    """Print the hash."""
    warnings.simplefilter("ignore")
    version.hash_of_sources = lambda *folders: 0
    digest = hashlib.sha256()
    for design, board in TARGETS:
        with tempfile.TemporaryDirectory() as made:
            prepare(find_target(design, board), Path(made))
            for path in sorted(Path(made).iterdir()):
                digest.update(path.name.encode() + b"\0" + path.read_bytes())
    print(digest.hexdigest())


if __name__ == "__main__":
    main()
