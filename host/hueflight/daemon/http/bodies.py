# SPDX-License-Identifier: Apache-2.0
"""What requests of the API may say: types of their bodies and queries, with limits and help."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from hueflight.daemon.picture_settings import LONGEST_S
from hueflight.daemon.recordings_folder import NAME

NAME_PATTERN = f"^{NAME.pattern}$"
Name = Annotated[
    str,
    msgspec.Meta(
        pattern=NAME_PATTERN,
        description="Name of the recording. By default it is the present time.",
    ),
]
Kind = Annotated[
    Literal["scene", "reference", "bands", "dark", "flat"],
    msgspec.Meta(
        description="Kind of capture, which decides which LEDs fire: all for scene and reference, "
        "one at a time for bands, none for dark and flat."
    ),
]


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Body of a request, in which unknown keys are errors."""


class RecordingLimits(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Name of a recording, and when it ends by itself."""

    name: Name | None = None
    frames: Annotated[
        int,
        msgspec.Meta(
            ge=0,
            le=1_000_000_000,
            description="Number of frames after which the recording ends, for kind bands of each "
            "LED. 0 means no limit.",
        ),
    ] = 0
    seconds: (
        Annotated[
            float,
            msgspec.Meta(gt=0, le=1e7, description="Seconds after which the recording ends."),
        ]
        | None
    ) = None


class RecordBody(RecordingLimits, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of a recording, which ends at the first limit that is reached."""

    kind: Kind = "scene"
    note: Annotated[
        str, msgspec.Meta(max_length=1000, description="Note that is kept in the recording.")
    ] = ""
    until_depth_std: (
        Annotated[
            float,
            msgspec.Meta(
                gt=0,
                le=1000,
                description="Standard deviation of depth, in metres, that ends the recording once "
                "enough pixels have reached it. This needs a calibration.",
            ),
        ]
        | None
    ) = None
    until_reflectance_std: (
        Annotated[
            float,
            msgspec.Meta(
                gt=0,
                le=1000,
                description="Standard deviation of the reflectance in every band that ends the "
                "recording once enough pixels have reached it. This needs a calibration.",
            ),
        ]
        | None
    ) = None
    share: Annotated[
        float,
        msgspec.Meta(
            gt=0,
            le=1,
            description="Fraction of the pixels that must reach the standard deviations.",
        ),
    ] = 0.9


class CamerasBody(RecordingLimits, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What all cameras do at the same time; if they record, what each recording is to be."""

    action: Annotated[
        Literal["start", "stop", "record", "end"],
        msgspec.Meta(
            description="Start or stop the runs, or begin or end a recording of each camera."
        ),
    ]


class RenameBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is changed of a recording."""

    name: Annotated[
        str,
        msgspec.Meta(pattern=NAME_PATTERN, description="Name that the recording is given."),
    ]


class PictureBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How live pictures are made from now on; what is not given stays as it is."""

    frames: (
        Annotated[
            int,
            msgspec.Meta(
                ge=0,
                le=10_000_000,
                description="Number of frames behind each picture at least, rounded up to a "
                "multiple of those from one picture to the next. 0 restores what the daemon's "
                "configuration says.",
            ),
        ]
        | msgspec.UnsetType
    ) = msgspec.UNSET
    integration_s: (
        Annotated[
            float,
            msgspec.Meta(
                ge=0,
                le=LONGEST_S,
                description="Longest time in seconds over which photons of a pixel add up while it "
                "does not change; null for no limit, 0 for the newest frames alone.",
            ),
        ]
        | msgspec.UnsetType
        | None
    ) = msgspec.UNSET
    method: (
        Annotated[str, msgspec.Meta(description="Method of reconstruction.")] | msgspec.UnsetType
    ) = msgspec.UNSET


class CalibrateBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of the captures of a calibration."""

    distance: Annotated[
        float,
        msgspec.Meta(gt=0, le=1000, description="Distance of the reference target, in metres."),
    ]
    frames: Annotated[
        int, msgspec.Meta(ge=1, le=10_000_000, description="Number of frames of each capture.")
    ] = 4000
    bands: Annotated[
        bool,
        msgspec.Meta(description="Also capture the reference target with one LED at a time."),
    ] = True
    dark: Annotated[bool, msgspec.Meta(description="Also take a capture with all LEDs off.")] = (
        False
    )


class CheckBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Capture with which the calibration in use is checked."""

    kind: Annotated[
        Literal["reference", "scene"],
        msgspec.Meta(
            description='"reference" for the target of the calibration, "scene" for anything else.'
        ),
    ] = "scene"
    frames: Annotated[
        int, msgspec.Meta(ge=1, le=10_000_000, description="Number of frames of the capture.")
    ] = 4000
    distance: (
        Annotated[
            float,
            msgspec.Meta(
                gt=0,
                le=1000,
                description="Distance of the reference target, in metres; by default that of the "
                "calibration.",
            ),
        ]
        | None
    ) = None


_Unset = msgspec.UnsetType
_Index = Annotated[int, msgspec.Meta(ge=0, le=65535)]
Span = Annotated[
    tuple[_Index, _Index], msgspec.Meta(description="The first and the last one that is sent.")
]
Pixels = Annotated[
    tuple[tuple[_Index, _Index], ...],
    msgspec.Meta(max_length=4096, description="Row and column of each pixel that is not sent."),
]
Rate = Annotated[float, msgspec.Meta(gt=0, le=1e6, description="Frames per second.")]


_Time = Annotated[float, msgspec.Meta(ge=0, le=1e6)]


class ScheduleBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When each LED fires within the period."""

    delays_ns: Annotated[
        tuple[_Time | Annotated[tuple[_Time, ...], msgspec.Meta(min_length=1, max_length=16)], ...],
        msgspec.Meta(
            min_length=1,
            max_length=64,
            description="Delay of each band's LED in nanoseconds, or several for an LED that fires "
            "several times in a period.",
        ),
    ]
    period_ns: Annotated[
        _Time | None,
        msgspec.Meta(description="Period in nanoseconds; null for that of the instrument."),
    ] = None


class ControlsBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What of camera and LEDs is changed; null for the default, and nothing for no change."""

    rate_hz: Rate | _Unset | None = msgspec.UNSET
    rows: Span | _Unset | None = msgspec.UNSET
    cols: Span | _Unset | None = msgspec.UNSET
    gate: Span | _Unset | None = msgspec.UNSET
    masked: Pixels | _Unset | None = msgspec.UNSET
    schedule: ScheduleBody | _Unset | None = msgspec.UNSET


class SimulationBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is done to a simulated camera; what is not given stays as it is."""

    plugged: (
        Annotated[
            bool, msgspec.Meta(description="False to pull its cable, true to plug it in again.")
        ]
        | msgspec.UnsetType
    ) = msgspec.UNSET
    moving: (
        Annotated[bool, msgspec.Meta(description="True to have a ball move in front of the scene.")]
        | msgspec.UnsetType
    ) = msgspec.UNSET
    drift_ps_per_s: (
        Annotated[
            float,
            msgspec.Meta(
                ge=-1000,
                le=1000,
                description="Picoseconds by which LED light arrives later with every second; 0 "
                "takes the drift back.",
            ),
        ]
        | msgspec.UnsetType
    ) = msgspec.UNSET


_Place = Annotated[
    int,
    msgspec.Meta(
        ge=0,
        le=(1 << 53) - 1,
        description="First frame of a recording, or number of a picture, from 0.",
    ),
]
_End = Annotated[
    int,
    msgspec.Meta(
        ge=1,
        le=(1 << 53) - 1,
        description="Frame after the last one, or number of the next picture.",
    ),
]


class PlaybackQuery(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which frames of a recording, or which picture of a result, are shown."""

    start: _Place
    stop: _End


class PixelQuery(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Coordinates of a pixel."""

    row: Annotated[int, msgspec.Meta(ge=0, le=1023, description="Row of the pixel, from 0.")]
    col: Annotated[int, msgspec.Meta(ge=0, le=1023, description="Column of the pixel, from 0.")]


class MaterialQuery(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which abundance or index is wanted."""

    name: Annotated[str, msgspec.Meta(description="One of the instrument's `materials`.")]


class PlaybackPixelQuery(PixelQuery, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Coordinates of a pixel, and which frames or picture it is looked at in."""

    start: _Place
    stop: _End
