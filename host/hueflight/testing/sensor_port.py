# SPDX-License-Identifier: Apache-2.0
"""What the readout of a sensor must do at the sensor port of the camera's gateware.

The rules are those of ``hueflight_hdl.camera.sensor.port``; the checks know the port by its
members alone. They simulate the readout with Amaranth.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hueflight.files.optional import import_optional

EXPOSURE_CLOCKS = 16


@dataclass(frozen=True)
class ReadoutExample:
    """A readout, and what the camera was built for.

    Attributes
    ----------
    component : Component
        Amaranth component with the member ``port``, a `SensorPort` as its sensor sees it. It has
        one clock domain, ``sync``.
    rows, cols : int
        Pixels of the sensor.
    lanes : int
        Codes in a beat.
    patience : int
        Clocks in which a beat must come, from the request and from the beat before.
    settings : dict
        Values of further inputs, by the name of the member.
    """

    component: Any
    rows: int
    cols: int
    lanes: int
    patience: int = 256
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def beats(self) -> int:
        """Beats of a frame; the last one may have unused lanes."""
        return -(-self.rows * self.cols // self.lanes)


@dataclass(frozen=True)
class Beats:
    """Beats that came.

    Attributes
    ----------
    clocks : ndarray of int, shape (beat,)
        Clock of each beat since the simulation began.
    codes : ndarray of int, shape (beat, lane)
        Codes.
    marks : ndarray of bool, shape (beat, 3)
        Marks of a frame's first pixel, of a row's first pixel, and of the last pixel.
    requests : ndarray of int, shape (frame,)
        Clocks of the requests.
    """

    clocks: NDArray[np.int64]
    codes: NDArray[np.int64]
    marks: NDArray[np.bool_]
    requests: NDArray[np.int64]


def record(example: ReadoutExample, /, *, frames: int, idle: int = 0) -> Beats:
    """Simulate exposures and readouts.

    Parameters
    ----------
    example : ReadoutExample
        The readout.
    frames : int
        Exposures, each of which is read out before the next one.
    idle : int
        Clocks before the first exposure, and after the last readout.

    Returns
    -------
    Beats
        All beats.
    """
    simulation = import_optional("amaranth.sim", extra="hdl")
    port, counted = example.component.port, {"clock": 0, "beats": 0}
    clocks: list[int] = []
    codes: list[list[int]] = []
    marks: list[tuple[int, int, int]] = []
    requests: list[int] = []

    async def watch(ctx: Any) -> None:
        beats = port.beats
        async for _, _, valid, beat in ctx.tick().sample(beats.valid, beats.payload):
            if valid:
                clocks.append(counted["clock"])
                codes.append([int(code) for code in beat.codes])
                marks.append((beat.first, beat.row, beat.last))
            counted["clock"] += 1

    async def expose(ctx: Any) -> None:
        for name, value in example.settings.items():
            ctx.set(getattr(example.component, name), value)
        await ctx.tick().repeat(max(idle, 1))
        for _ in range(frames):
            ctx.set(port.expose, 1)
            await ctx.tick().repeat(EXPOSURE_CLOCKS)
            ctx.set(port.expose, 0)
            await ctx.tick()
            ctx.set(port.read, 1)
            requests.append(counted["clock"])
            await ctx.tick()
            ctx.set(port.read, 0)
            await _wait(ctx)
        await ctx.tick().repeat(max(idle, 1))

    async def _wait(ctx: Any) -> None:
        """Until the frame is over, or the camera would give it up."""
        wanted, quiet = len(requests) * example.beats, 0
        while len(clocks) < wanted and quiet < example.patience:
            before = len(clocks)
            await ctx.tick()
            quiet = 0 if len(clocks) > before else quiet + 1

    simulator = simulation.Simulator(example.component)
    simulator.add_clock(1e-8)
    simulator.add_process(watch)
    simulator.add_testbench(expose)
    simulator.run()
    return Beats(
        np.array(clocks, np.int64),
        np.array(codes, np.int64).reshape(-1, example.lanes),
        np.array(marks, bool).reshape(-1, 3),
        np.array(requests, np.int64),
    )


class SensorPortChecks:
    """Tests of a readout; a subclass gives the fixture `example`, made anew for each test."""

    frames = 3

    @pytest.fixture
    def example(self) -> ReadoutExample:
        """Return the readout; to be given by the subclass."""
        raise NotImplementedError("give a fixture 'example' that returns a ReadoutExample")

    def test_nothing_comes_unless_it_is_asked_for(self, example: ReadoutExample) -> None:
        """Neither after reset nor after a readout."""
        beats = record(example, frames=1, idle=2 * example.patience)
        assert len(beats.clocks) == example.beats, (
            f"{len(beats.clocks)} beats for one request; a frame has {example.beats}"
        )
        assert (beats.clocks > beats.requests[0]).all(), "a beat came before the request"

    def test_each_request_brings_one_frame(self, example: ReadoutExample) -> None:
        """All its beats, before the next request, none later than the camera's patience."""
        beats = record(example, frames=self.frames)
        wanted = self.frames * example.beats
        assert len(beats.clocks) == wanted, f"{len(beats.clocks)} beats came, not {wanted}"
        frames = beats.clocks.reshape(self.frames, -1)
        assert (frames[:, 0] > beats.requests).all()
        assert (frames[:-1, -1] < beats.requests[1:]).all()
        pauses = np.diff(np.column_stack([beats.requests, frames]), axis=1)
        assert pauses.max() < example.patience, f"a pause of {pauses.max()} clocks"

    def test_marks_are_in_the_right_beats(self, example: ReadoutExample) -> None:
        """First pixel, first pixel of each row, last pixel: redundant, and the camera checks."""
        beats = record(example, frames=self.frames)
        assert len(beats.clocks) == self.frames * example.beats
        pixel = np.arange(example.beats * example.lanes).reshape(example.beats, -1)
        begins = (pixel % example.cols == 0) & (pixel < example.rows * example.cols)
        number = np.arange(example.beats)
        wanted = np.column_stack([number == 0, begins.any(axis=1), number == example.beats - 1])
        marks = beats.marks.reshape(self.frames, -1, 3)
        for place, name in enumerate(("first", "row", "last")):
            wrong = np.flatnonzero((marks[..., place] != wanted[:, place]).any(axis=0))
            assert not wrong.size, f"mark '{name}' is wrong in beats {wrong[:8]}"
