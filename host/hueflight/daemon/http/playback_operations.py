# SPDX-License-Identifier: Apache-2.0
"""Operations that list results, and play them and recordings."""

from __future__ import annotations

from typing import Any

from hueflight.daemon.http.answers import PixelAnswer, PlaybackAnswer, ResultsAnswer
from hueflight.daemon.http.bodies import PlaybackPixelQuery, PlaybackQuery
from hueflight.daemon.http.operation import PLAYBACK, Named, Operation
from hueflight.daemon.http.picture_message import encode_picture
from hueflight.daemon.service import Service


def _results(service: Service, _: None) -> dict[str, Any]:
    return {"results": service.results.listing()}


def _play(service: Service, named: Named) -> dict[str, Any]:
    return service.playback.describe(named.name)


def _play_picture(service: Service, named: Named) -> bytes:
    start, stop = named.body.start, named.body.stop
    picture, live_color = service.playback.picture(named.name, start, stop)
    return encode_picture(picture, live_color)


def _play_pixel(service: Service, named: Named) -> dict[str, Any]:
    wanted = named.body
    return service.playback.pixel(
        named.name, wanted.start, wanted.stop, row=wanted.row, col=wanted.col
    )


PLAYBACK_OPERATIONS: tuple[Operation, ...] = (
    Operation(
        "GET",
        "/api/results",
        "results",
        "List the images and counts in the folder of results",
        "Name, kind and time of each result, newest first.",
        _results,
        answer=ResultsAnswer,
    ),
    Operation(
        "GET",
        PLAYBACK + "{name}",
        "play",
        "Open a recording or result to be played",
        "Kind, length, duration, instrument, and the calibration that its pictures are made with.",
        _play,
        answer=PlaybackAnswer,
        conflicts=True,
        missing=True,
    ),
    Operation(
        "GET",
        PLAYBACK + "{name}/picture",
        "play_picture",
        "Get the picture of some frames of a recording, or a picture of a result",
        "Message of a picture, coded for display, as live pictures are.",
        _play_picture,
        query=PlaybackQuery,
        conflicts=True,
        missing=True,
    ),
    Operation(
        "GET",
        PLAYBACK + "{name}/pixel",
        "play_pixel",
        "Get one pixel of such a picture",
        "Histogram, depth, reflectance in each band and quality of the pixel.",
        _play_pixel,
        answer=PixelAnswer,
        query=PlaybackPixelQuery,
        conflicts=True,
        missing=True,
    ),
)
