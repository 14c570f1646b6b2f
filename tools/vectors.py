#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Write the golden vectors of the protocol: `python tools/vectors.py [FOLDER]`.

Every vector is a pair NAME.bin, NAME.json; protocol/vectors/README.md says how to read them.
The same call always writes the same bytes.
"""

import json
import sys
from pathlib import Path

from vector_damage import damage_vectors
from vector_messages import message_vectors
from vector_packets import packet_vectors

FOLDER = Path(__file__).resolve().parent.parent / "protocol" / "vectors"


def main() -> None:
    """Write all vectors into a folder, protocol/vectors by default."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for pattern in ("*.bin", "*.json"):
        for old in folder.glob(pattern):
            old.unlink()
    for name, data, expectation in [*packet_vectors(), *damage_vectors(), *message_vectors()]:
        (folder / f"{name}.bin").write_bytes(data)
        (folder / f"{name}.json").write_text(json.dumps(expectation, indent=1) + "\n")


if __name__ == "__main__":
    main()
