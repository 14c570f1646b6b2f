# SPDX-License-Identifier: Apache-2.0
"""The files of the live page, read once at the start: no path from a client reaches the disk."""

from __future__ import annotations

from importlib import resources

import numpy as np

from hueflight.color.colormap import colours

MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}
COLORMAP_FILE = "colormap.js"


def page_files() -> dict[str, bytes]:
    """Return the page's files by name, those that are generated included."""
    folder = resources.files("hueflight.daemon") / "page"
    found = {entry.name: entry.read_bytes() for entry in folder.iterdir() if media_type(entry.name)}
    found[COLORMAP_FILE] = colormap_module().encode()
    return found


def colormap_module() -> str:
    """Return an ES module with the colour map of `hueflight.color`, 256 colours as hex digits."""
    table = colours(np.linspace(0.0, 1.0, 256)[None], 0.0, 1.0)
    return (
        "// The colour map of hueflight.color: red, green and blue of 256 colours.\n"
        f'export const COLORMAP = "{table.tobytes().hex()}";\n'
    )


def media_type(name: str, /) -> str:
    """Media type of a file that the page consists of, empty for any other file."""
    return MEDIA_TYPES.get("." + name.rpartition(".")[2], "")
