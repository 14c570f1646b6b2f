# SPDX-License-Identifier: Apache-2.0
"""A testbench for the reduction that runs thousands of full frames."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from amaranth.hdl import Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out
from numpy.typing import NDArray

from hueflight_protocol import ReductionMode, ReductionRoom
from hueflight_protocol.reduction import ReductionTables, offsets_hash

from ..camera.exposure.frame_guard import PATIENCE_CLOCKS
from ..camera.formatter.pixel_filter import FILTER_LAYOUT, MASK_WORD
from ..camera.formatter.pixel_mask import PixelMask
from ..camera.formatter.reference import frame_beats, pack_beats
from ..camera.formatter.trailer import TrailerWriter
from ..camera.frame_format import FrameFormat
from ..camera.reduction.core import OFFSET_BITS
from ..camera.reduction.reducer import PACKET_WORDS, Reducer
from ..camera.reduction.settings import settings_layout
from .camera import MARKS_LAYOUT, frame_marks
from .cxxrtl import Simulation, SimulationError, simulate

GAP_CLOCKS = 4
"""From a frame's last beat to the next request."""
SETTLE_CLOCKS = 20
BATCH_CLOCKS = 10_000
MOST_BATCHES = 1000


class ReducerTestbench(wiring.Component):
    """A `Reducer` whose packets are completed and whose streams are plain ports.

    Parameters
    ----------
    form : FrameFormat
        Geometry and lanes.
    room : ReductionRoom
        Sums per pixel and their bits.

    Members
    -------
    began, ended, asked, read, filters, store, store_code, entries, move, move_group, offsets : In
        As those of `Reducer`.
    beat_valid, codes, marks : In
        A beat of the sensor.
    mask_write, mask_address, mask_word : In
        See `PixelMask`.
    take : In(1)
        The link takes a word.
    idle, added : Out(1)
        As those of `Reducer`.
    word_valid, word : Out
        A word of a packet.
    """

    def __init__(self, form: FrameFormat, room: ReductionRoom) -> None:
        self._reducer = Reducer(form, room, patience=PATIENCE_CLOCKS, packet_words=PACKET_WORDS)
        self._mask = PixelMask(form)
        super().__init__(
            {
                "began": In(1),
                "ended": In(1),
                "asked": In(settings_layout(room)),
                "read": In(1),
                "filters": In(FILTER_LAYOUT),
                "store": In(1),
                "store_code": In(16),
                "entries": In(data.ArrayLayout(room.entry_bits, room.sums)),
                "move": In(1),
                "move_group": In(20),
                "offsets": In(data.ArrayLayout(OFFSET_BITS, room.group)),
                "beat_valid": In(1),
                "codes": In(form.lanes * form.code_bits),
                "marks": In(MARKS_LAYOUT),
                "mask_write": In(1),
                "mask_address": In(len(self._mask.write_address)),
                "mask_word": In(MASK_WORD),
                "take": In(1),
                "idle": Out(1),
                "added": Out(1),
                "word_valid": Out(1),
                "word": Out(64),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.reducer = reducer = self._reducer
        m.submodules.trailer = trailer = TrailerWriter()
        m.submodules.mask = mask = self._mask
        now = Signal(64)
        m.d.sync += now.eq(now + 1)
        for name in (
            "began", "ended", "asked", "read", "filters", "store", "store_code", "entries",
            "move", "move_group", "offsets",
        ):  # fmt: skip
            m.d.comb += getattr(reducer, name).eq(getattr(self, name))
        beat = reducer.sensor.payload
        m.d.comb += [
            reducer.now.eq(now),
            reducer.about.periods.eq(1),
            reducer.sensor.valid.eq(self.beat_valid),
            beat.codes.eq(self.codes),
            beat.first.eq(self.marks.first),
            beat.row.eq(self.marks.row),
            beat.last.eq(self.marks.last),
            mask.write.eq(self.mask_write),
            mask.write_address.eq(self.mask_address),
            mask.write_word.eq(self.mask_word),
            mask.address.eq(reducer.mask_address),
            reducer.mask_data.eq(mask.word),
            reducer.o.ready.eq(self.take),
            trailer.i.valid.eq(reducer.o.valid & self.take),
            trailer.i.payload.eq(reducer.o.payload),
            self.word_valid.eq(trailer.o.valid),
            self.word.eq(trailer.o.payload.data),
            self.idle.eq(reducer.idle),
            self.added.eq(reducer.added),
        ]
        return m


class SimulatedReducer:
    """A running reduction: frames in, bytes of packets out.

    Parameters
    ----------
    form : FrameFormat
        Geometry and lanes.
    room : ReductionRoom
        Sums per pixel and their bits.

    Attributes
    ----------
    clocks, added : int
        Clocks so far, and frames that were added in them.
    """

    def __init__(self, form: FrameFormat, room: ReductionRoom) -> None:
        self.form, self.room = form, room
        self.clocks = self.added = 0
        self._simulation: Simulation = simulate(ReducerTestbench(form, room))
        self._filters = [0] * -(-FILTER_LAYOUT.size // 32)
        self._words: list[NDArray[np.uint64]] = []

    def load(self, tables: ReductionTables, offsets: NDArray[np.integer], /) -> None:
        """Store tables and offsets.

        Parameters
        ----------
        tables : ReductionTables
            Of as many sums as there is room for, at most.
        offsets : ndarray of int, shape (pixel,)
            Offset of each pixel, codes.
        """
        layout = data.ArrayLayout(self.room.entry_bits, self.room.sums)
        entries = np.zeros((self.room.sums, tables.entries.shape[1]), int)
        entries[: tables.sums] = tables.entries
        inputs = self._inputs(entries.shape[1])
        inputs["store"] = 1
        inputs["store_code"] = np.arange(len(inputs))
        for record, some in zip(inputs, entries.T.tolist(), strict=True):
            _put(record, "entries", layout, some)
        self._run(inputs)
        groups = offsets.astype(np.int8).view("<u4").reshape(-1, self.room.group // 4)
        inputs = self._inputs(len(groups) * (self.room.group // self.form.lanes + 1))
        held = np.repeat(groups, len(inputs) // len(groups), axis=0)
        inputs["offsets"] = held.view(inputs["offsets"].dtype).reshape(inputs["offsets"].shape)
        inputs["move_group"] = np.arange(len(inputs)) // (len(inputs) // len(groups))
        inputs["move"][:: len(inputs) // len(groups)] = 1
        self._run(inputs)

    def begin(
        self,
        tables: ReductionTables,
        offsets: NDArray[np.integer],
        /,
        *,
        frames: int,
        filters: dict[str, Any] | None = None,
        mask: NDArray[np.bool_] | None = None,
    ) -> None:
        """Begin a capture.

        Parameters
        ----------
        tables : ReductionTables
            As given to `load`, as are the offsets.
        offsets : ndarray of int, shape (pixel,)
            Offset of each pixel, codes.
        frames : int
            Frames of a picture.
        filters : dict, optional
            Fields of `FILTER_LAYOUT`; 0 where not given.
        mask : ndarray of bool, shape (row, col), optional
            Pixels that send 0 when the mask is on.
        """
        if mask is not None:
            bits = np.zeros(-(-self.form.pixels // MASK_WORD) * MASK_WORD, np.uint8)
            bits[: self.form.pixels] = mask.reshape(-1)
            words = np.packbits(bits, bitorder="little").view("<u4")
            inputs = self._inputs(len(words))
            inputs["mask_write"] = 1
            inputs["mask_address"] = np.arange(len(words))
            inputs["mask_word"] = words
            self._run(inputs)
        value = FILTER_LAYOUT.const(filters or {}).as_value().value
        self._filters = [value >> 32 * i & 0xFFFF_FFFF for i in range(len(self._filters))]
        asked = {
            "mode": ReductionMode.SUMS, "sums": tables.sums, "frames": frames,
            "first": tables.first, "last": tables.last, "tables": tables.hash,
            "moved": offsets_hash(offsets),
            "widths": [*tables.widths, *[0] * (self.room.sums - tables.sums)],
        }  # fmt: skip
        inputs = self._inputs(SETTLE_CLOCKS)
        for record in inputs:
            _put(record, "asked", settings_layout(self.room), asked)
        inputs["began"][-1] = 1
        self._run(inputs)

    def feed(
        self,
        frames: Iterable[NDArray[np.uint16]],
        /,
        *,
        rng: np.random.Generator,
        sensor_pause: float = 0.0,
        link_pause: float = 0.0,
    ) -> None:
        """Have the sensor send frames, one after another.

        Parameters
        ----------
        frames : iterable of ndarray, shape (row, col)
            Codes.
        rng : Generator
            Of the pauses.
        sensor_pause, link_pause : float
            Share of clocks in which no beat comes, no word is taken.
        """
        marks = frame_marks(self.form)
        for codes in frames:
            packed = pack_beats(self.form, frame_beats(self.form, codes))
            at = 1 + np.arange(len(packed))
            if sensor_pause:
                at += np.cumsum(rng.geometric(1 - sensor_pause, len(packed)) - 1)
            inputs = self._inputs(int(at[-1]) + 1 + GAP_CLOCKS)
            inputs["read"][0] = 1
            inputs["beat_valid"][at] = 1
            inputs["marks"][at] = marks
            words = np.zeros((len(inputs), packed.shape[1]), np.uint32)
            words[at] = packed
            inputs["codes"] = words.view(inputs["codes"].dtype).reshape(inputs["codes"].shape)
            inputs["take"] = rng.random(len(inputs)) >= link_pause
            self._run(inputs)

    def finish(self) -> None:
        """End the capture and take all that is still to be sent.

        Raises
        ------
        SimulationError
            If it does not end.
        """
        inputs = self._inputs(SETTLE_CLOCKS)
        inputs["ended"][0] = 1
        self._run(inputs)
        for _ in range(MOST_BATCHES):
            inputs = self._inputs(BATCH_CLOCKS)
            inputs["take"] = 1
            if self._run(inputs)["idle"].all():
                return
        raise SimulationError(f"sums still come after {MOST_BATCHES * BATCH_CLOCKS} clocks")

    def packets(self) -> bytes:
        """Return the bytes that the link has taken since this was last called."""
        words, self._words = self._words, []
        return np.concatenate(words).astype("<u8").tobytes() if words else b""

    def close(self) -> None:
        """End the simulation."""
        self._simulation.close()

    def _inputs(self, clocks: int) -> NDArray:
        inputs = self._simulation.inputs(clocks)
        inputs["filters"] = np.array(self._filters, np.uint32).reshape(inputs["filters"].shape[1:])
        return inputs

    def _run(self, inputs: NDArray) -> NDArray:
        outputs = self._simulation.run(inputs)
        self.clocks += len(inputs)
        self.added += int(outputs["added"].sum())
        self._words.append(outputs["word"][outputs["word_valid"] == 1])
        return outputs


def _put(record: NDArray, name: str, layout: data.Layout, value: Any) -> None:
    """Set a port of one record to a value of a layout."""
    bits = layout.const(value).as_value().value
    port = record[name]
    if np.ndim(port) == 0:
        record[name] = bits
    else:
        record[name] = [bits >> 32 * i & 0xFFFF_FFFF for i in range(len(port))]
