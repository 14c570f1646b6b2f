#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Generate the table of every entry of an instrument file in docs/instrument.md.

    python tools/instrument_docs.py [FILE]

This replaces the blocks between `<!-- generated: NAME -->` and `<!-- end -->`.
"""

import re
import sys
from pathlib import Path

from hueflight.model.instrument import Band, Instrument, Lens, Sensor, Timing
from hueflight.model.instrument_text import entries

#: tables of the file, in order: heading, class, and what the table describes
TABLES = (
    ("", Instrument, "Top of the file"),
    ("[sensor]", Sensor, "The array of pixels and its time stamps"),
    ("[timing]", Timing, "The period and the drive pulses"),
    ("[lens]", Lens, "The lens; the table may be left out"),
    ("[[bands]]", Band, "One table for each LED or laser"),
)

PAGE = Path(__file__).resolve().parent.parent / "docs" / "instrument.md"


def tables() -> str:
    """Return a section with a table for each part of the file."""
    lines = []
    for heading, section, about in TABLES:
        title = f"`{heading}`" if heading else "First lines"
        lines += [f"### {title}", "", f"{about}.", ""]
        lines += ["| entry | type | default | meaning |", "|---|---|---|---|"]
        for entry in entries(section):
            meaning = entry.meaning.replace("``", "`").replace("|", "\\|")
            kind = entry.kind.replace(" or None", "").replace("|", "\\|")
            lines.append(f"| `{entry.name}` | {kind} | {entry.default} | {meaning} |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    page = Path(sys.argv[1]) if len(sys.argv) > 1 else PAGE
    pattern = r"(<!-- generated: entries -->\n).*?(<!-- end -->)"
    text = re.sub(
        pattern,
        lambda found: f"{found[1]}\n{tables()}\n{found[2]}",
        page.read_text("utf-8"),
        flags=re.DOTALL,
    )
    page.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
