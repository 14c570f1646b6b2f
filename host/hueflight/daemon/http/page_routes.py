# SPDX-License-Identifier: Apache-2.0
"""Routes of the live page's files."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from hueflight.daemon.page_files import media_type, page_files


def page_routes() -> list[BaseRoute]:
    """Return a route for each file of the page."""
    return [_route(name, content) for name, content in page_files().items()]


def _route(name: str, content: bytes) -> Route:
    async def handler(_: Request) -> Response:
        headers = {"cache-control": "no-cache"}
        return Response(content, media_type=media_type(name), headers=headers)

    return Route("/" if name == "index.html" else f"/{name}", handler, methods=["GET"])
