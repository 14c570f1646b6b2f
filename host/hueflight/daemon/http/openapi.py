# SPDX-License-Identifier: Apache-2.0
"""The OpenAPI description of the API, generated from the table of operations."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any, get_args

import msgspec

from hueflight.daemon.http.answers import HealthAnswer
from hueflight.daemon.http.bodies import NAME_PATTERN
from hueflight.daemon.http.operation import Operation
from hueflight.daemon.http.operations import OPERATIONS
from hueflight.daemon.http.refusal import RefusalCode
from hueflight.daemon.http.roles import SESSION_PATH, TokenState
from hueflight.daemon.results_folder import FILE_NAME
from hueflight.daemon.server_config import Role

_ERROR = {
    "type": "object",
    "properties": {
        "error": {"type": "string", "description": "Reason for people."},
        "code": {
            "enum": list(get_args(RefusalCode)),
            "description": "Reason for programs, of a request that was not allowed.",
        },
    },
    "required": ["error"],
}
_REFUSALS = {
    "400": "The request is malformed.",
    "401": "The token is missing (code 'token missing') or wrong ('token wrong').",
    "403": "The request comes from a page of another origin, or needs the role of an operator.",
    "413": "The body of the request is too large.",
    "421": "The daemon does not serve the host that the request names.",
    "429": "The client sends too many requests.",
}


def describe(*, name: str, token: bool) -> dict[str, Any]:
    """Return the description of the API in OpenAPI 3.1.

    Parameters
    ----------
    name : str
        Name of the daemon.
    token : bool
        True if clients must send a token.

    Returns
    -------
    dict
        The description, ready for JSON.
    """
    types = {kind for op in OPERATIONS for kind in (op.body, op.answer) if kind is not None}
    _, components = msgspec.json.schema_components(
        sorted(types | {HealthAnswer}, key=lambda kind: kind.__name__),
        ref_template="#/components/schemas/{name}",
    )
    paths: dict[str, dict[str, Any]] = {}
    for operation in OPERATIONS:
        paths.setdefault(operation.path, {})[operation.method.lower()] = _operation(operation)
    paths["/health"] = {
        "get": {
            "operationId": "health",
            "summary": "Check whether the camera is connected and recordings are stored",
            "responses": {
                "200": _answer("The daemon works.", _reference(HealthAnswer)),
                "503": _answer(
                    "The camera is disconnected, or a recording has failed.",
                    _reference(HealthAnswer),
                ),
            }
            | _refusals(),
        }
    }
    paths[SESSION_PATH] = {"get": _session()}
    paths["/api/recordings/{name}/segments/{segment}"] = {"get": _download()}
    described: dict[str, Any] = {
        "openapi": "3.1.0",
        "info": {
            "title": f"Hueflight capture daemon {name!r}",
            "version": version("hueflight"),
            "description": (
                "Control of one camera: live pictures, recordings and calibrations. Live pictures "
                "are sent over the web socket `/api/live`."
            ),
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
        "responses": {"200": _result(operation)} | _refusals(),
        "parameters": [_name_parameter(operation)] if operation.named else [],
    }
    if operation.query is not None:
        schema = msgspec.json.schema(operation.query)["$defs"][operation.query.__name__]
        described["parameters"] += [
            {
                "name": name,
                "in": "query",
                "required": True,
                "description": field.pop("description"),
                "schema": field,
            }
            for name, field in schema["properties"].items()
        ]
    if operation.body is not None:
        described["requestBody"] = {
            "required": True,
            "content": {"application/json": {"schema": _reference(operation.body)}},
        }
        described["responses"]["415"] = _error("The body of the request is not declared as JSON.")
    if operation.body is not None or operation.query is not None or operation.plays:
        described["responses"]["422"] = _error("A value is missing, unknown or out of range.")
    if operation.conflicts:
        described["responses"]["409"] = _error(
            "The request conflicts with the present state: an operation in progress, an existing "
            "recording of the same name, or a missing calibration."
        )
    if operation.missing:
        described["responses"]["404"] = _error("There is no such recording, or no such pixel.")
    return described


def _session() -> dict[str, Any]:
    """Description of the request that says what a token is good for."""
    schema = {
        "type": "object",
        "properties": {
            "token": {"enum": list(get_args(TokenState))},
            "role": {"enum": [*get_args(Role), None]},
        },
        "required": ["token", "role"],
    }
    return {
        "operationId": "session",
        "summary": "Check the token that is sent; needs none",
        "responses": {"200": _answer("What the token is good for.", schema)} | _refusals(),
    }


def _download() -> dict[str, Any]:
    """Description of the download, the only answer that is no JSON."""
    number = {"type": "integer", "minimum": 0, "maximum": 999_999}
    content = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
    return {
        "operationId": "download",
        "summary": "Download a segment of a finished recording",
        "parameters": [
            _name_parameter(None),
            _path_parameter("segment", "Number of the segment, from 0.", number),
        ],
        "responses": {
            "200": {"description": "The file, an MCAP of its own.", "content": content},
            "206": {"description": "The range of it that was asked for.", "content": content},
            "404": _error("There is no such recording or segment."),
            "409": _error("The name is not one of a recording."),
            "416": {"description": "The range that was asked for lies outside of the file."},
        }
        | _refusals(),
    }


def _result(operation: Operation) -> dict[str, Any]:
    if operation.answer is not None:
        return _answer(operation.result, _reference(operation.answer))
    content = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
    return {"description": operation.result, "content": content}


def _reference(kind: type[msgspec.Struct]) -> dict[str, Any]:
    return {"$ref": f"#/components/schemas/{kind.__name__}"}


def _name_parameter(operation: Operation | None) -> dict[str, Any]:
    if operation is not None and operation.plays:
        schema = {"type": "string", "pattern": f"{NAME_PATTERN}|^{FILE_NAME.pattern}$"}
        return _path_parameter(
            "name", "Name of a recording, or of a result with its ending.", schema
        )
    schema = {"type": "string", "pattern": NAME_PATTERN}
    return _path_parameter("name", "Name of the recording.", schema)


def _path_parameter(name: str, text: str, schema: dict[str, Any]) -> dict[str, Any]:
    return {"name": name, "in": "path", "required": True, "description": text, "schema": schema}


def _refusals() -> dict[str, Any]:
    return {status: _error(reason) for status, reason in _REFUSALS.items()}


def _error(reason: str) -> dict[str, Any]:
    return _answer(reason, {"$ref": "#/components/schemas/Error"})


def _answer(reason: str, schema: dict[str, Any]) -> dict[str, Any]:
    return {"description": reason, "content": {"application/json": {"schema": schema}}}
