# SPDX-License-Identifier: Apache-2.0
"""Ready-made frames, which get new numbers each time they are sent.

Drawing photons is far slower than a camera. A simulated camera repeats a bank of frames in an order
that changes from pass to pass, so that the noise of its pictures differs for minutes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from hueflight.emulation.frame_template import Template
from hueflight.model.instrument import Instrument, Sensor
from hueflight_protocol import FrameFlags, encode_frame
from hueflight_protocol.wire import FRAME_HEADER


class FrameBank:
    """Frames by step of the sequencer program, repeated without end.

    Parameters
    ----------
    packets : iterable of bytes
        Frame packets; their step markers say which step they belong to.
    frames_per_step : int
        Number of frames from each step to the next; the last step goes on. 0 for the first step
        only.
    seed : int
        Seed of the order of repetition.
    """

    def __init__(
        self, packets: Iterable[bytes], *, frames_per_step: int = 0, seed: int = 0
    ) -> None:
        steps: dict[int, list[Template]] = {}
        for packet in packets:
            step = FRAME_HEADER.unpack(packet)["step"]
            steps.setdefault(step, []).append(Template(packet))
        self._steps: Sequence[list[Template]] = [steps[step] for step in sorted(steps)]
        self._frames_per_step = frames_per_step
        self._rng = np.random.default_rng(seed)
        self._first = 0  # number of the frame that comes first in the present order
        self._ordered: list[Template] = []

    @property
    def bytes_per_frame(self) -> float:
        """Mean size of a packet, in bytes."""
        sizes = [template.size for step in self._steps for template in step]
        return sum(sizes) / len(sizes)

    def template(self, frame: int, /) -> Template:
        """Return what the sensor sees in a frame of the run.

        Parameters
        ----------
        frame : int
            Number of the frame in the run.

        Returns
        -------
        Template
            The frame.
        """
        if not 0 <= frame - self._first < len(self._ordered):
            self._order(frame)
        return self._ordered[frame - self._first]

    def _order(self, frame: int) -> None:
        """Bring the frames of one pass through a step's bank into an order by chance."""
        each, last = self._frames_per_step, len(self._steps) - 1
        step = min(frame // each, last) if each else 0
        bank = self._steps[step]
        begin = frame - frame % len(bank)
        end = begin + len(bank)
        self._first = max(begin, step * each)
        if each and step < last:
            end = min(end, (step + 1) * each)
        order = self._rng.permutation(len(bank))[self._first - begin : end - begin]
        self._ordered = [bank[number] for number in order]

    @classmethod
    def random(
        cls, sensor: Sensor, *, occupancy: float, frames: int = 64, seed: int = 0, run: int = 512
    ) -> FrameBank:
        """Return a bank of frames without a scene, in which all codes are equally likely.

        Parameters
        ----------
        sensor : Sensor
            Geometry and code width.
        occupancy : float
            Probability that a pixel has a code.
        frames : int
            Number of frames.
        seed : int
            Seed of the codes and of the order of repetition.
        run : int
            Number of pixels per chunk of a packet.

        Returns
        -------
        FrameBank
            The bank.
        """
        rng = np.random.default_rng(seed)
        shape = (sensor.rows, sensor.cols)

        def packets() -> Iterable[bytes]:
            for _ in range(frames):
                codes = rng.integers(1, sensor.codes, shape) * (rng.random(shape) < occupancy)
                yield encode_frame(
                    codes, sequence=0, frame=0, timestamp=0, code_bits=sensor.code_bits, run=run,
                    flags=FrameFlags.SIMULATED,
                )  # fmt: skip

        return cls(packets(), seed=seed)


class FrameSource(Protocol):
    """What the sensor of an emulated camera sees."""

    def template(self, frame: int, /) -> Template:
        """Return what it sees in a frame of the run.

        Parameters
        ----------
        frame : int
            Number of the frame in the run.

        Returns
        -------
        Template
            The frame.
        """
        ...


def draw_packets(
    kind: str, instrument_json: str, scene: str, distance: float, frames: int, seed: int
) -> Iterator[bytes]:
    """Draw the packets of a simulated capture, in a process of its own.

    Parameters
    ----------
    kind : str
        Kind of the capture.
    instrument_json : str
        The instrument as JSON.
    scene : str
        Name of the scene, used where the kind is ``"scene"``.
    distance : float
        Distance of the white target, in metres.
    frames : int
        Number of frames.
    seed : int
        Seed of the photons.

    Returns
    -------
    iterator of bytes
        The packets.
    """
    from hueflight import simulator

    instrument = Instrument.from_json(instrument_json)
    looked_at = simulator.scene(scene, instrument) if kind == "scene" else None
    return simulator.simulate_packets(
        kind,  # pyright: ignore[reportArgumentType]
        instrument,
        frames=frames,
        scene=looked_at,
        distance=distance,
        seed=seed,
    )


def simulated_packets(
    kind: str, instrument_json: str, scene: str, distance: float, frames: int, seed: int
) -> list[bytes]:
    """Return all packets that `draw_packets` draws.

    Parameters
    ----------
    kind, instrument_json, scene : str
        Kind of the capture, the instrument as JSON, and name of the scene.
    distance : float
        Distance of the white target, in metres.
    frames, seed : int
        Number of frames, and seed of the photons.

    Returns
    -------
    list of bytes
        The packets.
    """
    return list(draw_packets(kind, instrument_json, scene, distance, frames, seed))
