# SPDX-License-Identifier: Apache-2.0
"""Register map of the camera: the board that reads the sensor and sends packets."""

from enum import IntEnum

from .clock_registers import EXTERNAL_CLOCK, REFERENCE_LOST, clock_failures, clock_registers
from .common_map import common_registers
from .errors import RegisterError
from .reduction_registers import ReductionRoom, reduction_registers
from .registers import Access, Field, Register, RegisterMap, Reserved, value
from .wire import DEFAULT_RUN, MAX_CODE_BITS, MAX_COLS, MAX_ROWS, PatternKind

BOARD = b"HCAM"
PIXEL_MASK_ADDRESS = 0x8000
"""One bit per pixel of the largest geometry fills the upper half of the address space."""


class SyntheticSource(IntEnum):
    """Where codes come from when the synthetic sensor is on."""

    COUNTER = 0
    RANDOM = 1
    SCENE = 2


def camera_map(
    *,
    rows: int = 192,
    cols: int = 128,
    code_bits: int = 9,
    lanes: int = 8,
    run: int = DEFAULT_RUN,
    geometry: int = 0,
    clock_hz: int = 100_000_000,
    reduction: ReductionRoom | None = None,
    external_clock: bool = False,
    reference_hz: int = 0,
) -> RegisterMap:
    """Return the camera's register map; addresses are the same for every build.

    Parameters
    ----------
    rows, cols : int
        Geometry in pixels, each 1 to 1024.
    code_bits : int
        Width of a code, 1 to 16.
    lanes : int
        Codes per clock at the sensor port.
    run : int
        Pixels per chunk.
    geometry : int
        Identity of the geometry, as in frame headers.
    clock_hz : int
        Frequency of the device clock.
    reduction : ReductionRoom, optional
        Room for sums; by default the build can't reduce codes to sums.
    external_clock : bool
        The build can run from an external clock; otherwise it has no registers for that.
    reference_hz : int
        Frequency of the external clock.

    Returns
    -------
    RegisterMap
        The registers.

    Raises
    ------
    RegisterError
        If a number is out of its range.
    """
    for name, number, high in (
        ("rows", rows, MAX_ROWS),
        ("cols", cols, MAX_COLS),
        ("code_bits", code_bits, MAX_CODE_BITS),
    ):
        if not 1 <= number <= high:
            raise RegisterError(f"{name} = {number}: must be from 1 to {high}")
    common = common_registers(
        BOARD,
        clock_hz=clock_hz,
        features=(*_FEATURES, EXTERNAL_CLOCK) if external_clock else _FEATURES,
        state=_STATE,
        faults=(*_FAULTS, _CLOCK_FAILED, REFERENCE_LOST) if external_clock else _FAULTS,
    )
    build = [
        Register(
            "geometry",
            0x010,
            Access.CONST,
            (Field("rows", 16, "pixels", reset=rows), Field("cols", 16, "pixels", reset=cols)),
            "size of a frame",
        ),
        Register(
            "format",
            0x011,
            Access.CONST,
            (
                Field("code_bits", 8, "width of a code", reset=code_bits, unit="bit"),
                Field("lanes", 8, "codes per clock at the sensor port", reset=lanes),
                Field("run", 16, "pixels per chunk", reset=run),
            ),
            "how frames are sent",
        ),
        Register(
            "geometry_id",
            0x012,
            Access.CONST,
            value(8, "0 = not stated", reset=geometry),
            "identity of the geometry, as in frame headers",
        ),
    ]
    return RegisterMap(
        "camera",
        [
            *common,
            *build,
            *_run(),
            *_counters(),
            *_filters(rows, cols, code_bits),
            *_synthetic(),
            *([] if reduction is None else reduction_registers(reduction)),
            *(_clock(reference_hz) if external_clock else ()),
        ],
    )


_FEATURES = (
    Field("temperature", 1, "the temperature is measured"),
    Field("sensor", 1, "a sensor is attached; without it only the synthetic one"),
    Field("scene", 1, "the synthetic sensor has a scene"),
    Field("overlap", 1, "the sensor keeps its codes while it exposes: readouts may overlap"),
)

_STATE = (
    Field("running", 1, "a capture is on"),
    Field("stopping", 1, "the capture ends after the present frame"),
    Field("exposing", 1, "an exposure is on"),
    Field("sending", 1, "a packet is being sent"),
    Field("stalled", 1, "the link takes no data"),
)

_FAULTS = (
    Field("dropped", 1, "a frame was dropped whole"),
    Field("aborted", 1, "a frame was aborted"),
    Field("trigger_lost", 1, "the illuminator missed a trigger"),
    Field("sensor", 1, "the sensor sent fewer or more codes than a frame has"),
    Field("saturated", 1, "a counter stands at its largest value"),
)
_CLOCK_FAILED = Field("clock_failed", 1, "the clock failed, which ended the capture")


def _clock(reference_hz: int) -> list[Register]:
    return [
        *clock_registers(reference_hz),
        clock_failures(0x017),
        Register(
            "time_sync",
            0x032,
            Access.PULSE,
            (
                Field("arm", 1, "the next rising edge on the input sets the time stamp to 0"),
                Field("send", 1, "send such an edge on the output"),
            ),
            "common time of several boards, in builds with an external clock",
        ),
        Register(
            "time_state",
            0x033,
            Access.RO,
            (
                Field("armed", 1, "an edge is waited for"),
                Field("done", 1, "it has come, and the clock has not failed since"),
                Field("level", 1, "level of the input"),
            ),
            "common time, in builds with an external clock",
        ),
    ]


def _run() -> list[Register]:
    rw = Access.RW
    return [
        Register(
            "run",
            0x018,
            Access.PULSE,
            (
                Field("start", 1, "begin; counters and the frame number start at 0"),
                Field("stop", 1, "end after the present frame"),
                Field("abort", 1, "end at once; a frame begun is sent as aborted"),
            ),
            "start and stop a capture",
        ),
        Register("capture", 0x019, rw, value(32, "any"), "label of the capture, in every packet"),
        Register(
            "period", 0x01A, rw, value(16, "", reset=32, unit="clock"), "period of the LED trains"
        ),
        Register(
            "exposure", 0x01B, rw, value(32, "", reset=3125, unit="period"), "length of an exposure"
        ),
        Register(
            "gap", 0x01C, rw, value(32, "", unit="clock"), "pause between readout and next exposure"
        ),
        Register(
            "readout",
            0x031,
            rw,
            (
                Field(
                    "overlap",
                    1,
                    "an exposure follows the one before, while that one is read out; "
                    "the gap lies between exposures",
                ),
            ),
            "when the sensor is read; of no effect without the feature",
        ),
        Register("frame_limit", 0x01D, rw, value(32, "0 = until stopped"), "frames in a capture"),
        Register(
            "trigger",
            0x01E,
            rw,
            (
                Field("width", 8, "of the trigger output", reset=2, unit="clock"),
                Field("inverted", 1, "the trigger output is low when active"),
                Field("always", 1, "trigger between exposures too"),
                Reserved(6),
                Field("sync_width", 8, "of the frame-sync output", reset=8, unit="clock"),
            ),
            "outputs to the illuminator",
        ),
        Register(
            "status_interval",
            0x01F,
            rw,
            value(32, "0 = never", unit="frame"),
            "frames from one status packet to the next",
        ),
    ]


def _counters() -> list[Register]:
    ro = Access.RO

    def wide(name: str, address: int, doc: str, unit: str = "") -> Register:
        return Register(name, address, ro, value(64, "", unit=unit), doc, words=2)

    def narrow(name: str, address: int, doc: str, unit: str = "") -> Register:
        return Register(name, address, ro, value(32, "", unit=unit), doc + ", saturating")

    return [
        wide("timestamp", 0x020, "device clock", "clock"),
        wide("frame", 0x022, "number of the present frame in the capture"),
        wide("frames_sent", 0x024, "frames sent whole in this capture"),
        wide("hits", 0x026, "codes other than 0 sent in this capture"),
        wide("periods", 0x028, "triggers sent in this capture"),
        narrow("frames_dropped", 0x02A, "frames dropped whole in this capture"),
        narrow("frames_aborted", 0x02B, "frames aborted in this capture"),
        narrow("triggers_lost", 0x02C, "triggers that the illuminator missed in this capture"),
        narrow("stall_clocks", 0x02D, "clocks in which the link was stalled", "clock"),
        narrow("buffer_peak", 0x02E, "most bytes that waited for the link in this capture", "byte"),
        Register("sequence", 0x02F, ro, value(32, ""), "number of the next packet, modulo 2^32"),
        Register("marker", 0x030, ro, value(16, ""), "step marker on the inputs now"),
    ]


def _filters(rows: int, cols: int, code_bits: int) -> list[Register]:
    rw = Access.RW

    def window(name: str, address: int, last: int, doc: str) -> Register:
        ends = (
            Field("first", 16, "first one kept"),
            Field("last", 16, "last one kept", reset=last),
        )
        return Register(name, address, rw, ends, doc)

    return [
        Register(
            "filters",
            0x038,
            rw,
            (
                Field("mask", 1, "masked pixels send code 0"),
                Field("roi", 1, "pixels outside the region of interest send code 0"),
                Field("gate", 1, "codes outside the gate are sent as 0"),
            ),
            "what is left out; taken over when a frame begins, as are the three below",
        ),
        window("roi_rows", 0x039, rows - 1, "rows of the region of interest"),
        window("roi_cols", 0x03A, cols - 1, "columns of the region of interest"),
        window("gate", 0x03B, (1 << code_bits) - 1, "codes of the time gate"),
        Register(
            "pixel_mask",
            PIXEL_MASK_ADDRESS,
            rw,
            value(32, "bit b of word w: pixel 32·w + b in readout order is masked"),
            "pixel mask; all 0 after configuration, unchanged by a reset",
            count=(-(-rows * cols // 32),),
            strides=(1,),
        ),
    ]


def _synthetic() -> list[Register]:
    rw = Access.RW
    return [
        Register(
            "synthetic",
            0x040,
            rw,
            (
                Field("enable", 1, "codes come from the synthetic sensor"),
                Field("source", 2, "kind of codes", choices=SyntheticSource),
                Reserved(13),
                Field("occupancy", 16, "share of pixels with a code other than 0, in 1/65536"),
            ),
            "synthetic sensor",
        ),
        Register("synthetic_seed", 0x041, rw, value(32, "not 0", reset=1), "seed of random codes"),
        Register(
            "synthetic_delay",
            0x042,
            rw,
            (
                Field("start", 16, "delay of the scene in the first frame", unit="code"),
                Field("step", 16, "added from frame to frame", unit="code", signed=True),
            ),
            "moving delay of the scene",
        ),
        Register(
            "test_packet",
            0x048,
            rw,
            (
                Field("words", 18, "words of the pattern", reset=256),
                Reserved(6),
                Field("pattern", 1, "kind of pattern", choices=PatternKind),
            ),
            "test packets",
        ),
        Register("test_seed", 0x049, rw, value(32, "first word", reset=1), "seed of test packets"),
        Register("test_send", 0x04A, Access.PULSE, value(1, "send one"), "send a test packet"),
    ]
