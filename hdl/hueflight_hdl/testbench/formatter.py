# SPDX-License-Identifier: Apache-2.0
"""A testbench for the frame formatter that runs thousands of full frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np
from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import fifo, wiring
from amaranth.lib.wiring import In, Out
from numpy.typing import NDArray

from ..camera.formatter.formatter import FrameFormatter
from ..camera.formatter.pixel_filter import FILTER_LAYOUT, MASK_WORD
from ..camera.formatter.pixel_mask import PixelMask
from ..camera.formatter.reference import SensorFrame, frame_beats, pack_beats
from ..camera.frame_format import INFO_LAYOUT, FrameFormat
from .cxxrtl import Simulation, SimulationError, simulate

WAITING_BEATS = 1 << 14
WAITING_FRAMES = 16
BATCH_CLOCKS = WAITING_BEATS // 4
SILENT_BATCHES = 50
"""Batches without a word after which nothing more is expected."""


class FormatterTestbench(wiring.Component):
    """A `FrameFormatter` with queues in front, so that a batch need not know what it takes.

    Members
    -------
    frame_valid, info, filters, beats : In
        A frame for the queue: what it is told, and its beats; one with fewer than the format
        has is aborted after them.
    beat_valid, codes : In
        A beat for the queue.
    give : In(1)
        The sensor offers a beat.
    take : In(1)
        The link takes a word.
    mask_write, mask_address, mask_word : In
        See `PixelMask`.
    begins, passes : Out(1)
        A frame, a beat, leaves its queue.
    word_valid, word, word_last : Out
        A word that is taken in this clock.
    """

    def __init__(self, form: FrameFormat, *, buffer_words: int) -> None:
        self.form = form
        self._formatter = FrameFormatter(form, buffer_words=buffer_words)
        self._mask = PixelMask(form)
        super().__init__(
            {
                "frame_valid": In(1),
                "info": In(INFO_LAYOUT),
                "filters": In(FILTER_LAYOUT),
                "beats": In(range(form.beats + 1)),
                "beat_valid": In(1),
                "codes": In(form.lanes * form.code_bits),
                "give": In(1),
                "take": In(1),
                "mask_write": In(1),
                "mask_address": In(len(self._mask.write_address)),
                "mask_word": In(MASK_WORD),
                "begins": Out(1),
                "passes": Out(1),
                "word_valid": Out(1),
                "word": Out(64),
                "word_last": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.formatter = formatter = self._formatter
        m.submodules.mask = mask = self._mask
        told = Cat(self.info, self.filters, self.beats)
        m.submodules.frames = frames = fifo.SyncFIFOBuffered(width=len(told), depth=WAITING_FRAMES)
        m.submodules.codes = codes = fifo.SyncFIFOBuffered(
            width=len(self.codes), depth=WAITING_BEATS
        )
        left = Signal.like(self.beats)  # beats until the frame is aborted
        beats = Signal.like(self.beats)
        settled = Signal()  # filters are taken over one clock before a frame's first beat
        m.d.sync += settled.eq(frames.r_rdy & ~self.begins)
        m.d.comb += [
            frames.w_data.eq(told),
            frames.w_en.eq(self.frame_valid),
            frames.r_en.eq(self.begins),
            Cat(formatter.info, formatter.filters, beats).eq(frames.r_data),
            codes.w_data.eq(self.codes),
            codes.w_en.eq(self.beat_valid),
            codes.r_en.eq(self.passes),
            formatter.beats.payload.eq(codes.r_data),
            formatter.abort.eq(formatter.in_frame & (left == 0)),
            formatter.beats.valid.eq(
                codes.r_rdy & self.give & (formatter.in_frame | settled) & ~formatter.abort
            ),
            self.passes.eq(formatter.beats.valid & formatter.beats.ready),
            self.begins.eq(formatter.begins),
            formatter.o.ready.eq(self.take),
            self.word_valid.eq(formatter.o.valid & self.take),
            self.word.eq(formatter.o.payload.data),
            self.word_last.eq(formatter.o.payload.last),
            formatter.mask_data.eq(mask.word),
            mask.address.eq(formatter.mask_address),
            mask.write.eq(self.mask_write),
            mask.write_address.eq(self.mask_address),
            mask.write_word.eq(self.mask_word),
        ]
        with m.If(self.passes):
            m.d.sync += left.eq(left - 1)
        with m.If(self.begins):
            m.d.sync += left.eq(beats - 1)
        return m


class SimulatedFormatter:
    """A running formatter.

    Parameters
    ----------
    form : FrameFormat
    buffer_words : int
        As in `FrameFormatter`.

    Attributes
    ----------
    ended : list of int
        Clocks in which packets ended.
    """

    def __init__(self, form: FrameFormat, *, buffer_words: int = 512) -> None:
        self.form = form
        self.clocks = 0
        self.ended: list[int] = []
        self._simulation: Simulation = simulate(FormatterTestbench(form, buffer_words=buffer_words))

    def set_mask(self, mask: NDArray[np.bool_], /) -> None:
        """Write the pixel mask, (rows, cols)."""
        bits = np.zeros(-(-self.form.pixels // MASK_WORD) * MASK_WORD, np.uint8)
        bits[: self.form.pixels] = mask.reshape(-1)
        words = np.packbits(bits, bitorder="little").view("<u4")
        inputs = self._simulation.inputs(len(words))
        inputs["mask_write"] = 1
        inputs["mask_address"] = np.arange(len(words))
        inputs["mask_word"] = words
        self._simulation.run(inputs)
        self.clocks += len(words)

    def packets(
        self,
        frames: Iterable[SensorFrame],
        /,
        *,
        seed: int = 0,
        sensor_pause: float = 0.0,
        link_pause: float = 0.0,
    ) -> Iterator[bytes]:
        """Yield the packets that come of `frames`, in bytes as they are sent.

        Parameters
        ----------
        frames : iterable of SensorFrame
            Taken as they are needed.
        seed : int
            Of the pauses.
        sensor_pause, link_pause : float
            Share of clocks in which no beat is offered, no word is taken.

        Raises
        ------
        SimulationError
            If nothing comes any more while packets are due.
        """
        rng = np.random.default_rng(seed)
        told: deque[SensorFrame] = deque()  # frames that are not in the queue yet
        beats = np.zeros((0, 0), np.uint32)  # beats that are not
        frames_waiting = beats_waiting = due = silent = 0
        begun: list[NDArray[np.uint64]] = []  # words of a packet that is not complete
        source = iter(frames)
        while True:
            # a batch's worth of beats, and the frames they belong to
            while len(beats) < BATCH_CLOCKS:
                frame = next(source, None)
                if frame is None:
                    break
                told.append(frame)
                due += 1
                packed = pack_beats(self.form, frame_beats(self.form, frame.codes))
                packed = packed[: frame.abort_after]
                beats = np.concatenate([beats, packed]) if len(beats) else packed
            if due == 0:
                return
            inputs = self._simulation.inputs(BATCH_CLOCKS)
            chosen = list(islice(told, WAITING_FRAMES - frames_waiting))
            for clock, frame in enumerate(chosen):
                self._tell(inputs[clock : clock + 1], frame)
                told.popleft()
            count = min(len(beats), BATCH_CLOCKS, WAITING_BEATS - beats_waiting)
            codes = inputs["codes"]
            codes[:count] = beats[:count].view(codes.dtype).reshape(codes[:count].shape)
            inputs["beat_valid"][:count] = 1
            beats = beats[count:]
            inputs["give"] = rng.random(BATCH_CLOCKS) >= sensor_pause
            inputs["take"] = rng.random(BATCH_CLOCKS) >= link_pause

            outputs = self._simulation.run(inputs)
            frames_waiting += len(chosen) - int(outputs["begins"].sum())
            beats_waiting += count - int(outputs["passes"].sum())
            valid = np.flatnonzero(outputs["word_valid"])
            words = outputs["word"][valid]
            ends = np.flatnonzero(outputs["word_last"][valid])
            self.ended += (self.clocks + valid[ends]).tolist()
            self.clocks += BATCH_CLOCKS
            silent = 0 if len(valid) else silent + 1
            if silent == SILENT_BATCHES:
                raise SimulationError(
                    f"no word in {silent * BATCH_CLOCKS} clocks, {due} packets are still due"
                )
            at = 0
            for end in (ends + 1).tolist():
                yield np.concatenate([*begun, words[at:end]]).astype("<u8").tobytes()
                begun.clear()
                at = end
                due -= 1
            begun.append(words[at:])

    def _tell(self, record: NDArray, frame: SensorFrame) -> None:
        form = self.form
        beats = form.beats if frame.abort_after is None else frame.abort_after
        record["frame_valid"] = 1
        record["beats"] = beats
        for name, layout, value in (
            ("info", INFO_LAYOUT, frame.info),
            ("filters", FILTER_LAYOUT, frame.filters),
        ):
            bits = layout.const(value).as_value().value
            words = record[name].shape[1]
            record[name][0] = [bits >> 32 * i & 0xFFFF_FFFF for i in range(words)]

    def close(self) -> None:
        """End the simulation."""
        self._simulation.close()
