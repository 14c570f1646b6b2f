# SPDX-License-Identifier: Apache-2.0
"""Registers of the camera as types; written by `tools/typed_registers.py`, not by hand."""

from dataclasses import dataclass
from typing import ClassVar

from ..camera_map import SyntheticSource
from ..reduction_registers import ReductionMode
from ..register_value import RegisterValue
from ..wire import PatternKind
from .common import (
    Board,
    ClockHz,
    ClockSource,
    ClockState,
    Map,
    ReferenceHz,
    RequestErrors,
    Requests,
    Scratch,
    Serial,
    Source,
    Temperature,
    Uptime,
    Versions,
)

__all__ = [
    "Board",
    "BufferPeak",
    "Capture",
    "ClockFailures",
    "ClockHz",
    "ClockSource",
    "ClockState",
    "Exposure",
    "Faults",
    "Features",
    "Filters",
    "Format",
    "Frame",
    "FrameLimit",
    "FramesAborted",
    "FramesDropped",
    "FramesSent",
    "Gap",
    "Gate",
    "Geometry",
    "GeometryId",
    "Hits",
    "Map",
    "Marker",
    "Period",
    "Periods",
    "PixelMask",
    "Readout",
    "Reduction",
    "ReductionCodes",
    "ReductionEntries",
    "ReductionFrames",
    "ReductionMove",
    "ReductionMoved",
    "ReductionNarrow",
    "ReductionOffsets",
    "ReductionRoom",
    "ReductionStore",
    "ReductionTables",
    "ReductionWidth",
    "ReferenceHz",
    "RequestErrors",
    "Requests",
    "RoiCols",
    "RoiRows",
    "Run",
    "Scratch",
    "Sequence",
    "Serial",
    "Source",
    "StallClocks",
    "State",
    "StatusInterval",
    "Synthetic",
    "SyntheticDelay",
    "SyntheticSeed",
    "Temperature",
    "TestPacket",
    "TestSeed",
    "TestSend",
    "TimeState",
    "TimeSync",
    "Timestamp",
    "Trigger",
    "TriggersLost",
    "Uptime",
    "Versions",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Features(RegisterValue):
    """What this build can do.

    Attributes
    ----------
    temperature : int
        The temperature is measured.
    sensor : int
        A sensor is attached; without it only the synthetic one.
    scene : int
        The synthetic sensor has a scene.
    overlap : int
        The sensor keeps its codes while it exposes: readouts may overlap.
    external_clock : int
        The board can run from an external clock.
    """

    NAME: ClassVar[str] = "features"
    ADDRESS: ClassVar[int] = 0x0007
    TEMPERATURE_MAX: ClassVar[int] = 1
    SENSOR_MAX: ClassVar[int] = 1
    SCENE_MAX: ClassVar[int] = 1
    OVERLAP_MAX: ClassVar[int] = 1
    EXTERNAL_CLOCK_MAX: ClassVar[int] = 1

    temperature: int = 0
    sensor: int = 0
    scene: int = 0
    overlap: int = 0
    external_clock: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class State(RegisterValue):
    """What the board is doing.

    Attributes
    ----------
    running : int
        A capture is on.
    stopping : int
        The capture ends after the present frame.
    exposing : int
        An exposure is on.
    sending : int
        A packet is being sent.
    stalled : int
        The link takes no data.
    """

    NAME: ClassVar[str] = "state"
    ADDRESS: ClassVar[int] = 0x0008
    RUNNING_MAX: ClassVar[int] = 1
    STOPPING_MAX: ClassVar[int] = 1
    EXPOSING_MAX: ClassVar[int] = 1
    SENDING_MAX: ClassVar[int] = 1
    STALLED_MAX: ClassVar[int] = 1

    running: int = 0
    stopping: int = 0
    exposing: int = 0
    sending: int = 0
    stalled: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults(RegisterValue):
    """What went wrong since last cleared.

    Attributes
    ----------
    dropped : int
        A frame was dropped whole.
    aborted : int
        A frame was aborted.
    trigger_lost : int
        The illuminator missed a trigger.
    sensor : int
        The sensor sent fewer or more codes than a frame has.
    saturated : int
        A counter stands at its largest value.
    clock_failed : int
        The clock failed, which ended the capture.
    reference_lost : int
        The external clock was lost while in use.
    """

    NAME: ClassVar[str] = "faults"
    ADDRESS: ClassVar[int] = 0x0009
    DROPPED_MAX: ClassVar[int] = 1
    ABORTED_MAX: ClassVar[int] = 1
    TRIGGER_LOST_MAX: ClassVar[int] = 1
    SENSOR_MAX: ClassVar[int] = 1
    SATURATED_MAX: ClassVar[int] = 1
    CLOCK_FAILED_MAX: ClassVar[int] = 1
    REFERENCE_LOST_MAX: ClassVar[int] = 1

    dropped: int = 0
    aborted: int = 0
    trigger_lost: int = 0
    sensor: int = 0
    saturated: int = 0
    clock_failed: int = 0
    reference_lost: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry(RegisterValue):
    """Size of a frame.

    Attributes
    ----------
    rows : int
        Pixels.
    cols : int
        Pixels.
    """

    NAME: ClassVar[str] = "geometry"
    ADDRESS: ClassVar[int] = 0x0010
    ROWS_MAX: ClassVar[int] = 65535
    COLS_MAX: ClassVar[int] = 65535

    rows: int
    cols: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Format(RegisterValue):
    """How frames are sent.

    Attributes
    ----------
    code_bits : int
        Width of a code, in bit.
    lanes : int
        Codes per clock at the sensor port.
    run : int
        Pixels per chunk.
    """

    NAME: ClassVar[str] = "format"
    ADDRESS: ClassVar[int] = 0x0011
    CODE_BITS_MAX: ClassVar[int] = 255
    LANES_MAX: ClassVar[int] = 255
    RUN_MAX: ClassVar[int] = 65535

    code_bits: int
    lanes: int
    run: int


@dataclass(frozen=True, slots=True)
class GeometryId(RegisterValue):
    """Identity of the geometry, as in frame headers.

    Attributes
    ----------
    value : int
        0 = not stated.
    """

    NAME: ClassVar[str] = "geometry_id"
    ADDRESS: ClassVar[int] = 0x0012
    VALUE_MAX: ClassVar[int] = 255

    value: int


@dataclass(frozen=True, slots=True)
class ClockFailures(RegisterValue):
    """Failures of the clock (the PLL lost lock) since configuration, saturating.

    Attributes
    ----------
    value : int
        Number.
    """

    NAME: ClassVar[str] = "clock_failures"
    ADDRESS: ClassVar[int] = 0x0017
    VALUE_MAX: ClassVar[int] = 65535

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Run(RegisterValue):
    """Start and stop a capture.

    Attributes
    ----------
    start : int
        Begin; counters and the frame number start at 0.
    stop : int
        End after the present frame.
    abort : int
        End at once; a frame begun is sent as aborted.
    """

    NAME: ClassVar[str] = "run"
    ADDRESS: ClassVar[int] = 0x0018
    START_MAX: ClassVar[int] = 1
    STOP_MAX: ClassVar[int] = 1
    ABORT_MAX: ClassVar[int] = 1

    start: int = 0
    stop: int = 0
    abort: int = 0


@dataclass(frozen=True, slots=True)
class Capture(RegisterValue):
    """Label of the capture, in every packet.

    Attributes
    ----------
    value : int
        Any.
    """

    NAME: ClassVar[str] = "capture"
    ADDRESS: ClassVar[int] = 0x0019
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Period(RegisterValue):
    """Period of the LED trains.

    Attributes
    ----------
    value : int
        Value, in clock.
    """

    NAME: ClassVar[str] = "period"
    ADDRESS: ClassVar[int] = 0x001A
    VALUE_MAX: ClassVar[int] = 65535

    value: int


@dataclass(frozen=True, slots=True)
class Exposure(RegisterValue):
    """Length of an exposure.

    Attributes
    ----------
    value : int
        Value, in period.
    """

    NAME: ClassVar[str] = "exposure"
    ADDRESS: ClassVar[int] = 0x001B
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Gap(RegisterValue):
    """Pause between readout and next exposure.

    Attributes
    ----------
    value : int
        Value, in clock.
    """

    NAME: ClassVar[str] = "gap"
    ADDRESS: ClassVar[int] = 0x001C
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class FrameLimit(RegisterValue):
    """Frames in a capture.

    Attributes
    ----------
    value : int
        0 = until stopped.
    """

    NAME: ClassVar[str] = "frame_limit"
    ADDRESS: ClassVar[int] = 0x001D
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Trigger(RegisterValue):
    """Outputs to the illuminator.

    Attributes
    ----------
    width : int
        Of the trigger output, in clock.
    inverted : int
        The trigger output is low when active.
    always : int
        Trigger between exposures too.
    sync_width : int
        Of the frame-sync output, in clock.
    """

    NAME: ClassVar[str] = "trigger"
    ADDRESS: ClassVar[int] = 0x001E
    WIDTH_MAX: ClassVar[int] = 255
    INVERTED_MAX: ClassVar[int] = 1
    ALWAYS_MAX: ClassVar[int] = 1
    SYNC_WIDTH_MAX: ClassVar[int] = 255

    width: int = 2
    inverted: int = 0
    always: int = 0
    sync_width: int = 8


@dataclass(frozen=True, slots=True)
class StatusInterval(RegisterValue):
    """Frames from one status packet to the next.

    Attributes
    ----------
    value : int
        0 = never, in frame.
    """

    NAME: ClassVar[str] = "status_interval"
    ADDRESS: ClassVar[int] = 0x001F
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Timestamp(RegisterValue):
    """Device clock.

    Attributes
    ----------
    value : int
        Value, in clock.
    """

    NAME: ClassVar[str] = "timestamp"
    ADDRESS: ClassVar[int] = 0x0020
    VALUE_MAX: ClassVar[int] = 18446744073709551615

    value: int


@dataclass(frozen=True, slots=True)
class Frame(RegisterValue):
    """Number of the present frame in the capture.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "frame"
    ADDRESS: ClassVar[int] = 0x0022
    VALUE_MAX: ClassVar[int] = 18446744073709551615

    value: int


@dataclass(frozen=True, slots=True)
class FramesSent(RegisterValue):
    """Frames sent whole in this capture.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "frames_sent"
    ADDRESS: ClassVar[int] = 0x0024
    VALUE_MAX: ClassVar[int] = 18446744073709551615

    value: int


@dataclass(frozen=True, slots=True)
class Hits(RegisterValue):
    """Codes other than 0 sent in this capture.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "hits"
    ADDRESS: ClassVar[int] = 0x0026
    VALUE_MAX: ClassVar[int] = 18446744073709551615

    value: int


@dataclass(frozen=True, slots=True)
class Periods(RegisterValue):
    """Triggers sent in this capture.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "periods"
    ADDRESS: ClassVar[int] = 0x0028
    VALUE_MAX: ClassVar[int] = 18446744073709551615

    value: int


@dataclass(frozen=True, slots=True)
class FramesDropped(RegisterValue):
    """Frames dropped whole in this capture, saturating.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "frames_dropped"
    ADDRESS: ClassVar[int] = 0x002A
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class FramesAborted(RegisterValue):
    """Frames aborted in this capture, saturating.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "frames_aborted"
    ADDRESS: ClassVar[int] = 0x002B
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class TriggersLost(RegisterValue):
    """Triggers that the illuminator missed in this capture, saturating.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "triggers_lost"
    ADDRESS: ClassVar[int] = 0x002C
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class StallClocks(RegisterValue):
    """Clocks in which the link was stalled, saturating.

    Attributes
    ----------
    value : int
        Value, in clock.
    """

    NAME: ClassVar[str] = "stall_clocks"
    ADDRESS: ClassVar[int] = 0x002D
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class BufferPeak(RegisterValue):
    """Most bytes that waited for the link in this capture, saturating.

    Attributes
    ----------
    value : int
        Value, in byte.
    """

    NAME: ClassVar[str] = "buffer_peak"
    ADDRESS: ClassVar[int] = 0x002E
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Sequence(RegisterValue):
    """Number of the next packet, modulo 2^32.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "sequence"
    ADDRESS: ClassVar[int] = 0x002F
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Marker(RegisterValue):
    """Step marker on the inputs now.

    Attributes
    ----------
    value : int
        Value.
    """

    NAME: ClassVar[str] = "marker"
    ADDRESS: ClassVar[int] = 0x0030
    VALUE_MAX: ClassVar[int] = 65535

    value: int


@dataclass(frozen=True, slots=True)
class Readout(RegisterValue):
    """When the sensor is read; of no effect without the feature.

    Attributes
    ----------
    overlap : int
        An exposure follows the one before, while that one is read out; the gap lies between
        exposures.
    """

    NAME: ClassVar[str] = "readout"
    ADDRESS: ClassVar[int] = 0x0031
    OVERLAP_MAX: ClassVar[int] = 1

    overlap: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSync(RegisterValue):
    """Common time of several boards, in builds with an external clock.

    Attributes
    ----------
    arm : int
        The next rising edge on the input sets the time stamp to 0.
    send : int
        Send such an edge on the output.
    """

    NAME: ClassVar[str] = "time_sync"
    ADDRESS: ClassVar[int] = 0x0032
    ARM_MAX: ClassVar[int] = 1
    SEND_MAX: ClassVar[int] = 1

    arm: int = 0
    send: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeState(RegisterValue):
    """Common time, in builds with an external clock.

    Attributes
    ----------
    armed : int
        An edge is waited for.
    done : int
        It has come, and the clock has not failed since.
    level : int
        Level of the input.
    """

    NAME: ClassVar[str] = "time_state"
    ADDRESS: ClassVar[int] = 0x0033
    ARMED_MAX: ClassVar[int] = 1
    DONE_MAX: ClassVar[int] = 1
    LEVEL_MAX: ClassVar[int] = 1

    armed: int = 0
    done: int = 0
    level: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Filters(RegisterValue):
    """What is left out; taken over when a frame begins, as are the three below.

    Attributes
    ----------
    mask : int
        Masked pixels send code 0.
    roi : int
        Pixels outside the region of interest send code 0.
    gate : int
        Codes outside the gate are sent as 0.
    """

    NAME: ClassVar[str] = "filters"
    ADDRESS: ClassVar[int] = 0x0038
    MASK_MAX: ClassVar[int] = 1
    ROI_MAX: ClassVar[int] = 1
    GATE_MAX: ClassVar[int] = 1

    mask: int = 0
    roi: int = 0
    gate: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class RoiRows(RegisterValue):
    """Rows of the region of interest.

    Attributes
    ----------
    first : int
        First one kept.
    last : int
        Last one kept.
    """

    NAME: ClassVar[str] = "roi_rows"
    ADDRESS: ClassVar[int] = 0x0039
    FIRST_MAX: ClassVar[int] = 65535
    LAST_MAX: ClassVar[int] = 65535

    first: int = 0
    last: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RoiCols(RegisterValue):
    """Columns of the region of interest.

    Attributes
    ----------
    first : int
        First one kept.
    last : int
        Last one kept.
    """

    NAME: ClassVar[str] = "roi_cols"
    ADDRESS: ClassVar[int] = 0x003A
    FIRST_MAX: ClassVar[int] = 65535
    LAST_MAX: ClassVar[int] = 65535

    first: int = 0
    last: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate(RegisterValue):
    """Codes of the time gate.

    Attributes
    ----------
    first : int
        First one kept.
    last : int
        Last one kept.
    """

    NAME: ClassVar[str] = "gate"
    ADDRESS: ClassVar[int] = 0x003B
    FIRST_MAX: ClassVar[int] = 65535
    LAST_MAX: ClassVar[int] = 65535

    first: int = 0
    last: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Synthetic(RegisterValue):
    """Synthetic sensor.

    Attributes
    ----------
    enable : int
        Codes come from the synthetic sensor.
    source : SyntheticSource | int
        Kind of codes.
    occupancy : int
        Share of pixels with a code other than 0, in 1/65536.
    """

    NAME: ClassVar[str] = "synthetic"
    ADDRESS: ClassVar[int] = 0x0040
    ENABLE_MAX: ClassVar[int] = 1
    SOURCE_MAX: ClassVar[int] = 3
    OCCUPANCY_MAX: ClassVar[int] = 65535

    enable: int = 0
    source: SyntheticSource | int = 0
    occupancy: int = 0


@dataclass(frozen=True, slots=True)
class SyntheticSeed(RegisterValue):
    """Seed of random codes.

    Attributes
    ----------
    value : int
        Not 0.
    """

    NAME: ClassVar[str] = "synthetic_seed"
    ADDRESS: ClassVar[int] = 0x0041
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticDelay(RegisterValue):
    """Moving delay of the scene.

    Attributes
    ----------
    start : int
        Delay of the scene in the first frame, in code.
    step : int
        Added from frame to frame, in code.
    """

    NAME: ClassVar[str] = "synthetic_delay"
    ADDRESS: ClassVar[int] = 0x0042
    START_MAX: ClassVar[int] = 65535
    STEP_MAX: ClassVar[int] = 32767
    STEP_MIN: ClassVar[int] = -32768

    start: int = 0
    step: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TestPacket(RegisterValue):
    """Test packets.

    Attributes
    ----------
    words : int
        Words of the pattern.
    pattern : PatternKind | int
        Kind of pattern.
    """

    NAME: ClassVar[str] = "test_packet"
    ADDRESS: ClassVar[int] = 0x0048
    WORDS_MAX: ClassVar[int] = 262143
    PATTERN_MAX: ClassVar[int] = 1

    words: int = 256
    pattern: PatternKind | int = 0


@dataclass(frozen=True, slots=True)
class TestSeed(RegisterValue):
    """Seed of test packets.

    Attributes
    ----------
    value : int
        First word.
    """

    NAME: ClassVar[str] = "test_seed"
    ADDRESS: ClassVar[int] = 0x0049
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class TestSend(RegisterValue):
    """Send a test packet.

    Attributes
    ----------
    value : int
        Send one.
    """

    NAME: ClassVar[str] = "test_send"
    ADDRESS: ClassVar[int] = 0x004A
    VALUE_MAX: ClassVar[int] = 1

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ReductionRoom(RegisterValue):
    """What the reduction has room for.

    Attributes
    ----------
    sums : int
        Sums per pixel.
    entry_bits : int
        Of a table entry, in bit.
    sum_bits : int
        Of a sum, in bit.
    group : int
        Whose offsets are stored together, in pixel.
    """

    NAME: ClassVar[str] = "reduction_room"
    ADDRESS: ClassVar[int] = 0x0050
    SUMS_MAX: ClassVar[int] = 255
    ENTRY_BITS_MAX: ClassVar[int] = 255
    SUM_BITS_MAX: ClassVar[int] = 255
    GROUP_MAX: ClassVar[int] = 255

    sums: int
    entry_bits: int
    sum_bits: int
    group: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduction(RegisterValue):
    """What is sent.

    Attributes
    ----------
    mode : ReductionMode | int
        What is sent.
    sums : int
        Sums per pixel in use.
    """

    NAME: ClassVar[str] = "reduction"
    ADDRESS: ClassVar[int] = 0x0051
    MODE_MAX: ClassVar[int] = 3
    SUMS_MAX: ClassVar[int] = 255

    mode: ReductionMode | int = 0
    sums: int = 0


@dataclass(frozen=True, slots=True)
class ReductionFrames(RegisterValue):
    """Frames of a picture.

    Attributes
    ----------
    value : int
        1 or more, in frame.
    """

    NAME: ClassVar[str] = "reduction_frames"
    ADDRESS: ClassVar[int] = 0x0052
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ReductionCodes(RegisterValue):
    """Range of codes that stand for a time.

    Attributes
    ----------
    first : int
        First code that adds.
    last : int
        Last code that adds.
    """

    NAME: ClassVar[str] = "reduction_codes"
    ADDRESS: ClassVar[int] = 0x0053
    FIRST_MAX: ClassVar[int] = 65535
    LAST_MAX: ClassVar[int] = 65535

    first: int = 0
    last: int = 0


@dataclass(frozen=True, slots=True)
class ReductionTables(RegisterValue):
    """Hash of the tables.

    Attributes
    ----------
    value : int
        As packets state it.
    """

    NAME: ClassVar[str] = "reduction_tables"
    ADDRESS: ClassVar[int] = 0x0054
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class ReductionMoved(RegisterValue):
    """CRC-32C of the offsets.

    Attributes
    ----------
    value : int
        As packets state it.
    """

    NAME: ClassVar[str] = "reduction_moved"
    ADDRESS: ClassVar[int] = 0x0055
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class ReductionStore(RegisterValue):
    """Store entries in the tables; only between captures.

    Attributes
    ----------
    value : int
        Code whose entries `reduction_entries` holds.
    """

    NAME: ClassVar[str] = "reduction_store"
    ADDRESS: ClassVar[int] = 0x0056
    VALUE_MAX: ClassVar[int] = 65535

    value: int


@dataclass(frozen=True, slots=True)
class ReductionMove(RegisterValue):
    """Store offsets; only between captures.

    Attributes
    ----------
    value : int
        Group of pixels whose offsets `reduction_offsets` holds.
    """

    NAME: ClassVar[str] = "reduction_move"
    ADDRESS: ClassVar[int] = 0x0057
    VALUE_MAX: ClassVar[int] = 1048575

    value: int


@dataclass(frozen=True, slots=True)
class ReductionNarrow(RegisterValue):
    """Sums that have one bit less than `reduction_room` says.

    Attributes
    ----------
    value : int
        Last sums, of those that there is room for.
    """

    NAME: ClassVar[str] = "reduction_narrow"
    ADDRESS: ClassVar[int] = 0x0058
    VALUE_MAX: ClassVar[int] = 255

    value: int


@dataclass(frozen=True, slots=True)
class ReductionWidth(RegisterValue):
    """Width of each sum.

    Attributes
    ----------
    value : int
        1 or more, in bit.
    """

    NAME: ClassVar[str] = "reduction_width"
    ADDRESS: ClassVar[int] = 0x0060
    VALUE_MAX: ClassVar[int] = 63

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ReductionEntries(RegisterValue):
    """Entries of one code; word w holds those of two sums.

    Attributes
    ----------
    even : int
        Of sum 2·w.
    odd : int
        Of sum 2·w + 1.
    """

    NAME: ClassVar[str] = "reduction_entries"
    ADDRESS: ClassVar[int] = 0x0080
    EVEN_MAX: ClassVar[int] = 65535
    ODD_MAX: ClassVar[int] = 65535

    even: int = 0
    odd: int = 0


@dataclass(frozen=True, slots=True)
class ReductionOffsets(RegisterValue):
    """Offsets of one group of pixels.

    Attributes
    ----------
    value : int
        Byte b of word w: pixel 4·w + b of the group, signed.
    """

    NAME: ClassVar[str] = "reduction_offsets"
    ADDRESS: ClassVar[int] = 0x00A0
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class PixelMask(RegisterValue):
    """Pixel mask; all 0 after configuration, unchanged by a reset.

    Attributes
    ----------
    value : int
        Bit b of word w: pixel 32·w + b in readout order is masked.
    """

    NAME: ClassVar[str] = "pixel_mask"
    ADDRESS: ClassVar[int] = 0x8000
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int
