# SPDX-License-Identifier: Apache-2.0
"""A sensor with serial lanes, at the level of its pins, and a camera behind them.

The pins of a simulation are words of bits, `gear` of each lane in each clock, as
`illuminator.gearing.simulated` has it for other pins.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice

import numpy as np
from amaranth.hdl import Module, Value
from amaranth.lib.wiring import In, Member, Out, connect
from numpy.typing import NDArray

from ..camera.camera import Camera, CameraConfig
from ..camera.formatter.reference import frame_beats
from ..camera.sensor.ddr.link_format import LinkFormat, control_word
from ..camera.sensor.ddr.receiver import DdrReceiver
from .camera import CameraTestbench, CompiledCamera, SimulatedCamera, Taking, frame_marks
from .cxxrtl import compile_design


class PinnedCameraTestbench(CameraTestbench):
    """A camera whose sensor has serial lanes.

    Members
    -------
    pins : In
        Bits of all lanes in this clock, see `LinkFormat.samples_layout`.
    expose_pin, read_pin : Out(1)
        To the sensor.
    locked : Out
        Lanes that are aligned.
    """

    def __init__(self, config: CameraConfig, link: LinkFormat) -> None:
        self.link = link
        super().__init__(config)

    def _sensor_members(self) -> dict[str, Member]:
        return {
            "pins": In(self.link.lanes * self.link.gear),
            "expose_pin": Out(1),
            "read_pin": Out(1),
            "locked": Out(self.link.lanes),
        }

    def _attach_sensor(self, m: Module, camera: Camera) -> None:
        m.submodules.receiver = receiver = DdrReceiver(self.link)
        connect(m, camera.sensor, receiver.port)
        m.d.comb += [
            Value.cast(receiver.samples).eq(self.pins),
            self.expose_pin.eq(receiver.expose_pin),
            self.read_pin.eq(receiver.read_pin),
            self.locked.eq(receiver.locked),
        ]


def compile_pinned_camera(config: CameraConfig, link: LinkFormat, /) -> CompiledCamera:
    """Compile a camera with serial lanes once, for any number of `SimulatedCamera`."""
    return compile_design(PinnedCameraTestbench(config, link), clocks={"sync": 1, "sensor": 1})


def frame_words(
    link: LinkFormat, codes: NDArray[np.uint16], /, *, pauses: Sequence[int] = ()
) -> NDArray[np.int64]:
    """Return the words of a frame, shape (words, lanes), from the start word to one of training.

    Parameters
    ----------
    link : LinkFormat
        Words and lanes.
    codes : array of uint16, (rows, cols)
        The frame.
    pauses : sequence of int
        Beats before which the sensor pauses for a word.
    """
    beats = frame_beats(link.form, codes).astype(np.int64)
    control = control_word(1 | frame_marks(link.form).astype(np.int64) << 1)
    words = np.column_stack([beats, control])
    pause = np.full(link.lanes, 0)
    pause[-1] = control_word(0)
    words = np.insert(words, list(pauses), pause, axis=0)
    edge = np.ones((1, link.lanes), np.int64)
    return np.concatenate([link.start * edge, words, link.training * edge])


class SensorPins:
    """What a sensor has on its pins: words as bits, each lane with a delay of its own.

    Parameters
    ----------
    link : LinkFormat
        Words and lanes.
    skews : sequence of int
        Bits by which each lane is late; the control lane is the last.

    Attributes
    ----------
    dead : set of int
        Lanes that stay low.
    """

    def __init__(self, link: LinkFormat, skews: Sequence[int]) -> None:
        self.link = link
        training = self._bits(np.full(1 + max(skews) // link.word_bits, link.training))
        self._waiting = [training[len(training) - skew :] for skew in skews]
        self.dead: set[int] = set()

    def send(self, words: NDArray[np.int64], /) -> None:
        """Send words, shape (words, lanes), after those that wait."""
        for lane, column in enumerate(words.T):
            self._waiting[lane] = np.concatenate([self._waiting[lane], self._bits(column)])

    def send_frame(self, words: NDArray[np.int64], /) -> None:
        """Send a frame; sensors with a fault send it in another way."""
        self.send(words)

    def train(self, count: int, /) -> None:
        """Send so many training words."""
        self.send(np.full((count, self.link.lanes), self.link.training))

    def slip_after(self, lane: int, /) -> None:
        """Lose the last bit of a lane that waits."""
        self._waiting[lane] = self._waiting[lane][:-1]

    def take(self, clocks: int, /) -> NDArray[np.uint8]:
        """Return the bits of so many clocks, shape (clocks, lanes · gear)."""
        gear = self.link.gear
        short = clocks * gear - min(map(len, self._waiting))
        if short > 0:
            self.train(-(-short // self.link.word_bits))
        taken = [bits[: clocks * gear].reshape(clocks, gear) for bits in self._waiting]
        for lane in self.dead:
            taken[lane] = np.zeros_like(taken[lane])
        self._waiting = [bits[clocks * gear :] for bits in self._waiting]
        return np.concatenate(taken, axis=1)

    def _bits(self, words: NDArray[np.int64]) -> NDArray[np.uint8]:
        shifts = np.arange(self.link.word_bits)
        return (words[:, None] >> shifts & 1).astype(np.uint8).reshape(-1)


def pin_records(bits: NDArray[np.uint8], like: NDArray, /) -> NDArray:
    """Return bits, shape (clocks, bits), as the words of a port of compiled simulation."""
    packed = np.packbits(bits, axis=1, bitorder="little")
    padded = np.zeros((len(bits), like.nbytes // len(bits)), np.uint8)
    padded[:, : packed.shape[1]] = packed
    return padded.view(like.dtype).reshape(like.shape)


class PinnedCamera(SimulatedCamera):
    """A running camera with a sensor on its pins.

    Each rising edge of the pin `read` makes the sensor send the next of its frames, after the
    clocks that are run at a time.

    Parameters
    ----------
    config, link
        See `PinnedCameraTestbench`.
    pins : SensorPins
        Delays of the lanes.
    frames : iterable of array of int, (words, lanes)
        Words of each frame, see `frame_words`.
    **options
        See `SimulatedCamera`.
    """

    def __init__(
        self,
        config: CameraConfig,
        link: LinkFormat,
        pins: SensorPins,
        frames: Iterable[NDArray[np.int64]],
        *,
        compiled: CompiledCamera | None = None,
        taking: Taking | None = None,
    ) -> None:
        compiled = compiled or compile_pinned_camera(config, link)
        super().__init__(config, compiled=compiled, taking=taking)
        self.pins = pins
        self._frames = iter(frames)
        self._read = 0  # level of the pin

    def run(self, inputs: NDArray | None = None, /, *, clocks: int = 0) -> NDArray:
        """Run a clock for each record of `inputs`, or so many; return the outputs."""
        inputs = self.inputs(clocks) if inputs is None else inputs
        inputs["pins"] = pin_records(self.pins.take(len(inputs)), inputs["pins"])
        outputs = super().run(inputs)
        levels = outputs["read_pin"].astype(int)
        edges = np.diff(levels, prepend=self._read) > 0
        self._read = levels[-1] if len(levels) else self._read
        for words in islice(self._frames, int(edges.sum())):
            self.pins.send_frame(words)
        return outputs
