# SPDX-License-Identifier: Apache-2.0
"""The daemon's ASGI application: the live page, the API, metrics and health."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import asdict
from typing import Any

import msgspec
import structlog
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp

from hueflight.acquisition.plan import CaptureError
from hueflight.daemon.config import DaemonConfig
from hueflight.daemon.http.access import PERMISSION, AccessControl
from hueflight.daemon.http.camera_relay import relay
from hueflight.daemon.http.foxglove_app import by_port, foxglove_app
from hueflight.daemon.http.live_socket import Hub
from hueflight.daemon.http.metrics import make_registry, render
from hueflight.daemon.http.openapi import describe
from hueflight.daemon.http.operation import Named, Operation
from hueflight.daemon.http.operations import OPERATIONS
from hueflight.daemon.http.page_routes import page_routes
from hueflight.daemon.http.picture_encoding import PictureEncoding
from hueflight.daemon.http.picture_message import encode_picture
from hueflight.daemon.http.roles import SESSION_PATH
from hueflight.daemon.materials import MaterialError
from hueflight.daemon.picture import Picture
from hueflight.daemon.picture_settings import PictureSettingsError
from hueflight.daemon.pixel import PixelError
from hueflight.daemon.playable import PlaybackError
from hueflight.daemon.recordings_folder import RecordingMissingError, RecordingNameError
from hueflight.daemon.server_config import Tokens
from hueflight.daemon.service import Service
from hueflight.daemon.systemd import notify, watchdog_interval_s
from hueflight.devices.errors import DeviceError
from hueflight.devices.pulse_schedule import ScheduleError
from hueflight.devices.rig import Connect
from hueflight.errors import HueflightError, InstrumentError
from hueflight.live.protocol import Coding
from hueflight.model.instrument import Instrument

log = structlog.get_logger("hueflight.daemon")
DOWNLOAD_PATH = "/api/recordings/{name}/segments/{segment:int}"


def make_app(
    config: DaemonConfig,
    connect: Connect,
    instrument: Instrument,
    /,
    *,
    port: int,
    tokens: Tokens,
    foxglove_port: int | None = None,
) -> ASGIApp:
    """Return the application; acquisition begins when the server starts it.

    Parameters
    ----------
    config : DaemonConfig
        Configuration.
    connect : callable
        Opens the rig; see `hueflight.devices.rig.Connect`.
    instrument : Instrument
        Instrument that the camera belongs to.
    port : int
        Port on which the server listens; part of the hosts that requests may name.
    tokens : Tokens
        Tokens that clients must send.
    foxglove_port : int, optional
        Port of the same server on which Foxglove is served.

    Returns
    -------
    ASGI application
        The application with access control.
    """
    state: dict[str, Any] = {}

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()

        def on_picture(picture: Picture) -> None:
            if "hub" not in state or not service.viewers:
                return  # nobody is watching: spare the work
            if "foxglove" in state:
                state["foxglove"].offer(picture)
            encoding.offer(picture)

        def encode(picture: Picture) -> None:
            hub: Hub = state["hub"]
            messages: dict[Coding, bytes] = {
                coding: encode_picture(picture, service.live_color, coding=coding)
                for coding in hub.codings
            }
            loop.call_soon_threadsafe(hub.publish, picture, messages)

        encoding = PictureEncoding(encode)

        service = await run_in_threadpool(
            lambda: Service(config, connect, instrument, on_picture=on_picture)
        )
        state["service"] = service
        state["hub"] = Hub(service, config.server.max_viewers)
        if foxglove_port is not None:
            from hueflight.daemon.http.foxglove_hub import FoxgloveHub

            state["foxglove"] = FoxgloveHub(service, config.server.max_viewers)
        state["registry"] = make_registry(service)
        watchdog = asyncio.create_task(_keep_watchdog(service))
        notify("READY=1")
        yield
        log.info("shutting down")
        notify("STOPPING=1")
        watchdog.cancel()
        if "foxglove" in state:
            await state["foxglove"].close()
        await run_in_threadpool(service.close)
        await run_in_threadpool(encoding.close)
        log.info("ended", **service.status()["totals"])

    async def live(socket: Any) -> None:
        await state["hub"].serve(socket)

    async def live_of_another(socket: Any) -> None:
        others = state["service"].cameras.others
        number = socket.path_params["number"]
        if not 1 <= number <= len(others):
            await socket.close(1008, f"there is no camera {number}")
            return
        await relay(socket, others[number - 1])

    async def metrics(_: Request) -> Response:
        text = await run_in_threadpool(render, state["registry"])
        return Response(text, media_type="text/plain; version=0.0.4; charset=utf-8")

    async def health(_: Request) -> Response:
        problems = state["service"].problems()
        return _json(
            {
                "healthy": not problems,
                "state": state["service"].status()["state"],
                "problems": problems,
            },
            503 if problems else 200,
        )

    async def session(request: Request) -> Response:
        return _json(asdict(request.scope[PERMISSION]))

    async def download(request: Request) -> Response:
        name, number = request.path_params["name"], request.path_params["segment"]
        try:
            path = await run_in_threadpool(state["service"].folder.segment, name, number)
        except HueflightError as error:
            return _json({"error": str(error)}, _status_of(error))
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)

    description = describe(name=config.name, token=tokens.operator is not None)

    async def openapi(_: Request) -> Response:
        return _json(description)

    routes: list[BaseRoute] = [
        *(_route(operation, state) for operation in OPERATIONS),
        Route(SESSION_PATH, session, methods=["GET"]),
        Route(DOWNLOAD_PATH, download, methods=["GET"]),
        Route("/openapi.json", openapi, methods=["GET"]),
        Route("/metrics", metrics, methods=["GET"]),
        Route("/health", health, methods=["GET"]),
        WebSocketRoute("/api/live", live),
        WebSocketRoute("/api/cameras/{number:int}/live", live_of_another),
        *page_routes(),
    ]
    app = Starlette(
        routes=routes,
        lifespan=lifespan,
        exception_handlers={HTTPException: _http_error, Exception: _internal_error},
    )
    guarded = AccessControl(app, config.server, port=port, tokens=tokens)
    if foxglove_port is None:
        return guarded
    foxglove = foxglove_app(
        lambda: state["foxglove"], config.server, port=foxglove_port, tokens=tokens
    )
    return by_port(guarded, {foxglove_port: foxglove})


async def _keep_watchdog(service: Service) -> None:
    """Tell systemd that the daemon is well, as long as it is."""
    interval_s = watchdog_interval_s()
    while interval_s is not None:
        if not service.hangs:
            problems = "; ".join(service.problems()).replace("\n", " ")
            notify(f"WATCHDOG=1\nSTATUS={problems or 'well'}")
        await asyncio.sleep(interval_s)


def _route(operation: Operation, state: dict[str, Any]) -> Route:
    async def handler(request: Request) -> Response:
        argument: Any = None
        try:
            if operation.body is not None:
                argument = await _read_body(request, operation.body)
            elif operation.query is not None:
                argument = _read_query(request, operation.query)
            if operation.named:
                argument = Named(request.path_params["name"], argument)
            result = await run_in_threadpool(operation.action, state["service"], argument)
        except HueflightError as error:
            return _json({"error": str(error)}, _status_of(error))
        if isinstance(result, bytes):
            return Response(result, media_type="application/octet-stream")
        return _json(result)

    return Route(operation.path, handler, methods=[operation.method], name=operation.name)


async def _read_body(request: Request, kind: type[Any]) -> Any:
    if request.headers.get("content-type", "").split(";")[0].strip() != "application/json":
        raise HTTPException(415, "the body must be JSON: send 'Content-Type: application/json'")
    try:
        body = await request.body()
    except ClientDisconnect:
        raise HTTPException(413, "the body is too large, or the client has disconnected") from None
    try:
        return msgspec.json.decode(body, type=kind)
    except msgspec.ValidationError as error:
        raise HTTPException(422, str(error)) from None
    except (msgspec.DecodeError, UnicodeError) as error:
        raise HTTPException(400, f"the body is not valid JSON: {error}") from None


def _read_query(request: Request, kind: type[Any]) -> Any:
    pairs = request.query_params.multi_items()
    if len({name for name, _ in pairs}) < len(pairs):
        raise HTTPException(422, "a query parameter occurs twice")
    try:
        return msgspec.convert(dict(pairs), kind, strict=False)
    except msgspec.ValidationError as error:
        raise HTTPException(422, str(error)) from None


#: what the boards or the daemon can't do, or the file does not hold
_NOT_POSSIBLE = (DeviceError, InstrumentError, ScheduleError, PictureSettingsError, PlaybackError)


def _status_of(error: HueflightError) -> int:
    if isinstance(error, PixelError | MaterialError | RecordingMissingError):
        return 404
    if isinstance(error, RecordingNameError | CaptureError):
        return 409
    if isinstance(error, _NOT_POSSIBLE):
        return 422
    return 500


def _json(content: dict[str, Any], status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type="application/json")


async def _http_error(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    response = _json({"error": error.detail}, error.status_code)
    for name, value in (error.headers or {}).items():
        response.headers[name] = value
    return response


async def _internal_error(request: Request, error: Exception) -> Response:
    log.error("a request failed", path=request.url.path, error=repr(error), exc_info=error)
    return _json(
        {"error": "the daemon failed to process the request; its log has the details"}, 500
    )
