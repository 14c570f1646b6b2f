# SPDX-License-Identifier: Apache-2.0
"""The API's description says what each answer holds, and the answers hold that."""

from __future__ import annotations

import time
from typing import Any

import msgspec
import pytest

pytest.importorskip("starlette", reason="the extra 'daemon' is not installed")

from starlette.testclient import TestClient

from hueflight.daemon.http.answers import HealthAnswer
from hueflight.daemon.http.operation import Operation
from hueflight.daemon.http.operations import OPERATIONS

OPERATION = {operation.name: operation for operation in OPERATIONS}


def untyped(schema: Any, where: str, components: dict[str, Any], seen: set[str]) -> list[str]:
    """Places of a schema at which it does not say what is there."""
    if "$ref" in schema:
        name = schema["$ref"].removeprefix("#/components/schemas/")
        return [] if name in seen else untyped(components[name], name, components, seen | {name})
    if "anyOf" in schema:
        parts = enumerate(schema["anyOf"])
        return [p for n, one in parts for p in untyped(one, f"{where}|{n}", components, seen)]
    if "enum" in schema or "const" in schema:
        return []
    found: list[str] = []
    kind = schema.get("type")
    if kind == "object":
        more = schema.get("additionalProperties")
        if "properties" not in schema and not isinstance(more, dict):
            return [where]
        for name, field in schema.get("properties", {}).items():
            found += untyped(field, f"{where}.{name}", components, seen)
        if isinstance(more, dict):
            found += untyped(more, f"{where}.*", components, seen)
    elif kind == "array":
        found += untyped(schema.get("items", {}), f"{where}[]", components, seen)
    elif kind is None:
        found.append(where)
    return found


def test_every_answer_has_a_type_all_the_way_down(client: TestClient) -> None:
    document = client.get("/openapi.json").json()
    components = document["components"]["schemas"]
    walked, problems = 0, []
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for status, answer in operation["responses"].items():
                for kind, content in answer.get("content", {"": {}}).items():
                    where = f"{method} {path} {status} {kind}"
                    if status == "416":  # its body says nothing
                        continue
                    assert content.get("schema"), where
                    problems += untyped(content["schema"], where, components, set())
                    walked += 1
    assert walked > 100
    assert problems == []


def test_the_walk_finds_what_is_untyped() -> None:
    schema = {"type": "object", "properties": {"a": {"type": "array"}, "b": {"type": "object"}}}
    assert untyped(schema, "x", {}, set()) == ["x.a[]", "x.b"]
    assert untyped({"anyOf": [{"type": "null"}, {}]}, "x", {}, set()) == ["x|1"]


def as_described(answer: Any, operation: Operation) -> Any:
    """Check that an answer has the fields of its type, and no others; return its content."""
    assert answer.status_code == 200, answer.text
    content = answer.json()
    assert operation.answer is not None
    typed = msgspec.convert(content, operation.answer)
    assert msgspec.to_builtins(typed) == content
    return content


def test_answers_are_as_described(client: TestClient) -> None:
    seen: set[str] = set()

    def call(name: str, json: Any = None, /, **path: Any) -> Any:
        operation = OPERATION[name]
        where = operation.path.format(**path) + path.get("query", "")
        sent = {} if json is None else {"json": json}
        seen.add(name)
        return as_described(client.request(operation.method, where, **sent), operation)

    def until(is_true: Any) -> None:
        deadline = time.monotonic() + 30
        while not is_true():
            assert time.monotonic() < deadline
            time.sleep(0.02)

    call("instrument")
    call("start")
    until(lambda: call("status")["picture"]["number"])
    name = call("record", {"frames": 60, "note": "of the test"})["name"]
    until(lambda: call("status")["recording"]["last"].get("name") == name)
    until(lambda: all(entry["finished"] for entry in call("recordings")["recordings"]))
    call("play", name=name)
    call("play_pixel", name=name, query="?start=0&stop=50&row=1&col=2")
    call("rename_recording", {"name": "other"}, name=name)
    call("delete_recording", name="other")
    call("record", {"frames": 0})
    call("stop_recording")
    until(lambda: not call("status")["recording"]["name"])
    call("results")
    call("controls")
    call("set_controls", {"rows": [1, 4], "masked": [[0, 1]]})
    call("set_controls", {"rows": None, "masked": None})
    call("picture", {"integration_s": None})
    call("pixel", query="?row=2&col=3")
    call("calibrate", {"distance": 0.4, "frames": 100_000})
    until(lambda: call("status")["calibration"]["progress"])
    call("cancel_calibration")
    until(lambda: call("status")["calibration"]["progress"] is None)
    call("cameras")
    call("act_together", {"action": "stop"})
    call("stop")
    health = client.get("/health").json()
    assert msgspec.to_builtins(msgspec.convert(health, HealthAnswer)) == health
    # the camera here can't be unplugged, the messages of pictures and maps have a format of their
    # own, and there is no calibration to check: see test_the_calibration_in_use_is_checked
    untold = {"simulate", "play_picture", "materials", "check", "correct"}
    assert seen == OPERATION.keys() - untold
