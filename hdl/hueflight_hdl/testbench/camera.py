# SPDX-License-Identifier: Apache-2.0
"""A testbench for the camera, with a Python model of its link, host and sensor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from amaranth.hdl import Module
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Member, Out
from numpy.typing import NDArray

from hueflight_protocol import control

from ..camera.camera import Camera, CameraConfig
from ..camera.clock import camera_clock_members
from ..camera.exposure.control import MARKER_BITS
from ..camera.formatter.reference import frame_beats, pack_beats
from ..camera.frame_format import FrameFormat
from .cxxrtl import Simulation, SimulationError, compile_design
from .cxxrtl_shim import Port

ANSWER_CLOCKS = 20_000
"""More than any request takes."""

MARKS_LAYOUT = data.StructLayout({"first": 1, "row": 1, "last": 1})


class CameraTestbench(wiring.Component):
    """A `Camera` whose streams are plain ports; a response is always taken.

    Members
    -------
    request_valid, request_data, request_end, request_bad : In
        A byte of a request, or its end.
    response_valid, response_data, response_last : Out
        A byte of the response.
    take : In(1)
        The link takes a word.
    word_valid, word, word_last : Out
        A word that is taken in this clock.
    expose, read : Out(1)
        To the sensor.
    beat_valid, codes, marks : In
        From it.
    trigger, frame_sync, marker, missed
        As in `Camera`, as are those of the clock in builds with an external one.
    """

    def __init__(self, config: CameraConfig) -> None:
        self.config = config
        super().__init__(
            {
                "request_valid": In(1),
                "request_data": In(8),
                "request_end": In(1),
                "request_bad": In(1),
                "response_valid": Out(1),
                "response_data": Out(8),
                "response_last": Out(1),
                "take": In(1),
                "word_valid": Out(1),
                "word": Out(64),
                "word_last": Out(1),
                "expose": Out(1),
                "read": Out(1),
                **self._sensor_members(),
                "trigger": Out(1),
                "frame_sync": Out(1),
                "marker": In(MARKER_BITS),
                "missed": In(1),
                **self._clock_members(),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.camera = camera = Camera(self.config)
        request, response = camera.requests, camera.responses
        packets = camera.packets
        m.d.comb += [
            request.valid.eq(self.request_valid),
            request.payload.data.eq(self.request_data),
            request.payload.end.eq(self.request_end),
            request.payload.bad.eq(self.request_bad),
            response.ready.eq(1),
            self.response_valid.eq(response.valid),
            self.response_data.eq(response.payload.data),
            self.response_last.eq(response.payload.last),
            packets.ready.eq(self.take),
            self.word_valid.eq(packets.valid & self.take),
            self.word.eq(packets.payload.data),
            self.word_last.eq(packets.payload.last),
            self.expose.eq(camera.sensor.expose),
            self.read.eq(camera.sensor.read),
            self.trigger.eq(camera.trigger),
            self.frame_sync.eq(camera.frame_sync),
            camera.marker.eq(self.marker),
            camera.missed.eq(self.missed),
        ]
        for name, member in self._clock_members().items():
            mine, inner = getattr(self, name), getattr(camera, name)
            m.d.comb += inner.eq(mine) if member.flow is In else mine.eq(inner)
        self._attach_sensor(m, camera)
        return m

    def _clock_members(self) -> dict[str, Member]:
        """Return the ports of the clock, where there are any."""
        return camera_clock_members() if self.config.reference_hz else {}

    def _sensor_members(self) -> dict[str, Member]:
        """Return the ports of the sensor."""
        form = self.config.form
        return {
            "beat_valid": In(1),
            "codes": In(form.lanes * form.code_bits),
            "marks": In(MARKS_LAYOUT),
        }

    def _attach_sensor(self, m: Module, camera: Camera) -> None:
        """Connect the camera's sensor port."""
        beats = camera.sensor.beats
        m.d.comb += [
            beats.valid.eq(self.beat_valid),
            beats.payload.codes.eq(self.codes),
            beats.payload.first.eq(self.marks.first),
            beats.payload.row.eq(self.marks.row),
            beats.payload.last.eq(self.marks.last),
        ]


Taking = Callable[[int], NDArray[np.bool_]]
"""From a number of clocks to those in which the link takes a word."""

CompiledCamera = tuple[Path, list[Port]]


def compile_camera(config: CameraConfig, /) -> CompiledCamera:
    """Compile a camera once, for any number of `SimulatedCamera`."""
    return compile_design(CameraTestbench(config))


class SimulatedCamera:
    """A running camera: requests in, responses and packets out, time in clocks.

    Parameters
    ----------
    config : CameraConfig
        What is built.
    taking : callable, optional
        When the link takes words; by default always.
    compiled : optional
        Of the same configuration, by `compile_camera`.

    Attributes
    ----------
    clocks : int
        Clocks since configuration.
    registers : RegisterMap
        Of this build.
    """

    def __init__(
        self,
        config: CameraConfig,
        *,
        taking: Taking | None = None,
        compiled: CompiledCamera | None = None,
    ) -> None:
        self.config = config
        self.clocks = 0
        self.taking = taking
        self.registers = config.registers()
        self._transaction = 0
        self._simulation = Simulation(*(compiled or compile_camera(config)))
        self._words: list[NDArray[np.uint64]] = []

    def run(self, inputs: NDArray | None = None, /, *, clocks: int = 0) -> NDArray:
        """Run a clock for each record of `inputs`, or so many; return the outputs."""
        if inputs is None:
            inputs = self._simulation.inputs(clocks)
        inputs["take"] = True if self.taking is None else self.taking(len(inputs))
        outputs = self._simulation.run(inputs)
        self._words.append(outputs["word"][outputs["word_valid"] == 1])
        self.clocks += len(inputs)
        return outputs

    def inputs(self, clocks: int, /) -> NDArray:
        """Return input records of so many clocks in which nothing happens."""
        return self._simulation.inputs(clocks)

    def request(self, message: bytes, /) -> bytes:
        """Send a request, run until it is answered, and return the answer.

        Raises
        ------
        SimulationError
            If there is none.
        """
        inputs = self._simulation.inputs(len(message) + 1)
        inputs["request_valid"] = 1
        inputs["request_data"][:-1] = np.frombuffer(message, np.uint8)
        inputs["request_end"][-1] = 1
        answer = [self.run(inputs)]
        for _ in range(0, ANSWER_CLOCKS, 200):
            answer.append(self.run(clocks=200))
            if (answer[-1]["response_valid"] & answer[-1]["response_last"]).any():
                break
        else:
            raise SimulationError(f"no answer to {message.hex(' ')} in {ANSWER_CLOCKS} clocks")
        outputs = np.concatenate(answer)
        taken = outputs["response_data"][outputs["response_valid"] == 1]
        return taken.astype(np.uint8).tobytes()

    def write(self, name: str, /, **fields: int) -> None:
        """Write a register; fields not given take their reset value."""
        register = self.registers[name]
        self._transact(control.write, register.address, [register.encode(**fields)])

    def write_words(self, name: str, words: Sequence[int], /) -> None:
        """Write the elements of an array of registers, from the first on."""
        address = self.registers[name].address
        for first in range(0, len(words), control.MAX_WORDS):
            self._transact(control.write, address + first, words[first : first + control.MAX_WORDS])

    def read(self, name: str, /) -> dict[str, int]:
        """Return the fields of a register."""
        register = self.registers[name]
        payload = self._transact(control.read, register.address, register.words)
        return register.decode(sum(word << 32 * i for i, word in enumerate(payload)))

    def _transact(self, request: Callable[..., control.Request], *what: Any) -> tuple[int, ...]:
        self._transaction = self._transaction + 1 & 0xFFFF
        asked = request(self._transaction, *what)
        answer = control.decode_response(self.request(control.encode_request(asked)))
        if answer.result != control.Result.OK or answer.transaction != asked.transaction:
            raise SimulationError(f"{asked} was answered {answer}")
        return answer.payload

    def readout(
        self, codes: NDArray[np.uint16], /, *, beats: Sequence[int] | slice = slice(None)
    ) -> NDArray:
        """Return the inputs that play the sensor: a frame or chosen beats, one in each clock."""
        form = self.config.form
        packed = pack_beats(form, frame_beats(form, codes))[beats]
        inputs = self._simulation.inputs(len(packed))
        inputs["codes"] = packed.view(inputs["codes"].dtype).reshape(inputs["codes"].shape)
        inputs["marks"] = frame_marks(form)[beats]
        inputs["beat_valid"] = 1
        return inputs

    def run_to_read(self, *, step: int = 100, limit: int = 1_000_000) -> None:
        """Run until the sensor is asked for a frame, a step at a time.

        Raises
        ------
        SimulationError
            If it is not asked in so many clocks.
        """
        for _ in range(0, limit, step):
            if self.run(clocks=step)["read"].any():
                return
        raise SimulationError(f"no readout was asked for in {limit} clocks")

    def packets(self) -> bytes:
        """Return the bytes that the link has taken since this was last called."""
        words = self._words
        self._words = []
        return np.concatenate(words).astype("<u8").tobytes() if words else b""

    def close(self) -> None:
        """End the simulation."""
        self._simulation.close()


def frame_marks(form: FrameFormat, /) -> NDArray[np.uint32]:
    """Return the marks of each beat of a frame, as `MARKS_LAYOUT` has them."""
    pixel = np.arange(form.beats * form.lanes).reshape(form.beats, form.lanes)
    rows = ((pixel % form.cols == 0) & (pixel < form.pixels)).any(axis=1)
    beat = np.arange(form.beats)
    return (beat == 0) | rows << 1 | (beat == form.beats - 1) << 2
