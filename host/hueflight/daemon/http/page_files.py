# SPDX-License-Identifier: Apache-2.0
"""The files of the live page, read once at the start: no path from a client reaches the disk."""

from __future__ import annotations

from importlib import resources

import numpy as np
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

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
    found = {entry.name: entry.read_bytes() for entry in folder.iterdir() if _suffix(entry.name)}
    found[COLORMAP_FILE] = colormap_module().encode()
    return found


def colormap_module() -> str:
    """Return an ES module with the colour map of `hueflight.color`, 256 colours as hex digits."""
    table = colours(np.linspace(0.0, 1.0, 256)[None], 0.0, 1.0)
    return (
        "// The colour map of hueflight.color: red, green and blue of 256 colours.\n"
        f'export const COLORMAP = "{table.tobytes().hex()}";\n'
    )


def page_routes() -> list[BaseRoute]:
    """Return a route for each file of the page."""
    return [_route(name, content) for name, content in page_files().items()]


def _route(name: str, content: bytes) -> Route:
    media_type = MEDIA_TYPES[_suffix(name)]

    async def handler(_: Request) -> Response:
        return Response(content, media_type=media_type, headers={"cache-control": "no-cache"})

    return Route("/" if name == "index.html" else f"/{name}", handler, methods=["GET"])


def _suffix(name: str) -> str:
    """Extension of a file that the page consists of, empty for any other file."""
    suffix = "." + name.rpartition(".")[2]
    return suffix if suffix in MEDIA_TYPES else ""
