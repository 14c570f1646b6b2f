"""The OpenAPI description of the API, written from the table of operations."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import msgspec

from hueflight.daemon.operations import OPERATIONS, Operation

_ERROR = {
    "type": "object",
    "properties": {"error": {"type": "string"}},
    "required": ["error"],
}
_REFUSALS = {
    "400": "not a request that can be read",
    "401": "a token is required",
    "403": "from a page of another origin",
    "413": "the body is too large",
    "421": "not a host that is served here",
    "429": "too many requests",
}


def describe(*, name: str, token: bool) -> dict[str, Any]:
    """The whole description, OpenAPI 3.1.

    Parameters
    ----------
    name : of the daemon.
    token : whether one is required.
    """
    bodies = [op.body for op in OPERATIONS if op.body is not None]
    _, components = msgspec.json.schema_components(
        bodies, ref_template="#/components/schemas/{name}"
    )
    paths: dict[str, dict[str, Any]] = {}
    for operation in OPERATIONS:
        paths.setdefault(operation.path, {})[operation.method.lower()] = _operation(operation)
    paths["/health"] = {
        "get": {
            "operationId": "health",
            "summary": "Whether the daemon does its work",
            "responses": {
                "200": _answer("all is well", {"type": "object"}),
                "503": _answer("the camera is away, or recording has failed", {"type": "object"}),
            }
            | _refusals(),
        }
    }
    described: dict[str, Any] = {
        "openapi": "3.1.0",
        "info": {
            "title": f"Hueflight capture daemon {name!r}",
            "version": version("hueflight"),
            "description": "Pictures come over the web socket `/api/live`; see docs/daemon.md.",
        },
        "paths": paths,
        "components": {"schemas": components | {"Error": _ERROR}},
    }
    if token:
        described["components"]["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
        described["security"] = [{"token": []}]
    return described


def _operation(operation: Operation) -> dict[str, Any]:
    described: dict[str, Any] = {
        "operationId": operation.name,
        "summary": operation.summary,
        "responses": {"200": _answer("done", {"type": "object"})} | _refusals(),
    }
    if operation.query is not None:
        schema = msgspec.json.schema(operation.query)["$defs"][operation.query.__name__]
        described["parameters"] = [
            {"name": name, "in": "query", "required": True, "schema": field}
            for name, field in schema["properties"].items()
        ]
    if operation.body is not None:
        reference = {"$ref": f"#/components/schemas/{operation.body.__name__}"}
        described["requestBody"] = {
            "required": True,
            "content": {"application/json": {"schema": reference}},
        }
        described["responses"]["415"] = _error("the body must be application/json")
    if operation.body is not None or operation.query is not None:
        described["responses"]["422"] = _error("a value is missing, unknown or out of range")
    if operation.conflicts:
        described["responses"]["409"] = _error("what goes on already does not allow it")
    if operation.missing:
        described["responses"]["404"] = _error("there is no such thing")
    return described


def _refusals() -> dict[str, Any]:
    return {status: _error(reason) for status, reason in _REFUSALS.items()}


def _error(reason: str) -> dict[str, Any]:
    return _answer(reason, {"$ref": "#/components/schemas/Error"})


def _answer(reason: str, schema: dict[str, Any]) -> dict[str, Any]:
    return {"description": reason, "content": {"application/json": {"schema": schema}}}
