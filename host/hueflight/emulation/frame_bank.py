# SPDX-License-Identifier: Apache-2.0
"""Ready-made frames, which get new numbers each time they are sent.

Drawing photons is far slower than a camera. A simulated camera repeats a bank of frames in an order
that changes from pass to pass, so that the noise of its pictures differs for minutes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import google_crc32c
import numpy as np

from hueflight.model.instrument import Instrument, Sensor
from hueflight_protocol import FrameFlags, encode_frame, xor_words
from hueflight_protocol.wire import FRAME_HEADER

_STAMP = struct.Struct("<IQQ")  # sequence, timestamp, frame
_SEQUENCE_AT = FRAME_HEADER.offset("sequence")
_DROPPED_AT = FRAME_HEADER.offset("dropped")
_CAPTURE_AT = FRAME_HEADER.offset("capture")
_CLOCK_AT = FRAME_HEADER.offset("clock_hz")
_CHECK_AT = FRAME_HEADER.offset("check")
_WORD = (1 << 32) - 1


class Template:
    """One frame packet whose numbers are still to be filled in.

    Parameters
    ----------
    packet : bytes
        A complete frame packet.
    """

    __slots__ = ("_check", "_packet", "filtered")

    def __init__(self, packet: bytes) -> None:
        self.filtered: tuple[object, Template] | None = None  #: by which filter, and the result
        self._packet = bytearray(packet)
        for at, size in ((_SEQUENCE_AT, 20), (_DROPPED_AT, 4), (_CAPTURE_AT, 8), (_CHECK_AT, 4)):
            self._packet[at : at + size] = bytes(size)
        self._check = xor_words(bytes(self._packet[: FRAME_HEADER.size]))

    def __len__(self) -> int:
        """Return the number of bytes of the packet."""
        return len(self._packet)

    def stamp(
        self,
        *,
        sequence: int,
        timestamp: int,
        frame: int,
        dropped: int = 0,
        capture: int = 0,
        clock_hz: int = 0,
    ) -> bytes:
        """Return the packet with these numbers and with a correct check word and CRC.

        Parameters
        ----------
        sequence, timestamp, frame, dropped, capture, clock_hz : int
            Fields of the frame header.

        Returns
        -------
        bytes
            The packet.
        """
        packet = self._packet
        _STAMP.pack_into(packet, _SEQUENCE_AT, sequence, timestamp, frame)
        packet[_DROPPED_AT : _DROPPED_AT + 4] = dropped.to_bytes(4, "little")
        packet[_CAPTURE_AT : _CAPTURE_AT + 4] = capture.to_bytes(4, "little")
        packet[_CLOCK_AT : _CLOCK_AT + 4] = clock_hz.to_bytes(4, "little")
        check = self._check ^ sequence ^ dropped ^ capture ^ clock_hz
        check ^= timestamp & _WORD ^ timestamp >> 32 ^ frame & _WORD ^ frame >> 32
        packet[_CHECK_AT : _CHECK_AT + 4] = check.to_bytes(4, "little")
        body = bytes(memoryview(packet)[:-4])
        return body + google_crc32c.value(body).to_bytes(4, "little")


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
        self._order: list[int] = []
        self._place: tuple[int, int] = (-1, -1)

    @property
    def bytes_per_frame(self) -> float:
        """Mean size of a packet, in bytes."""
        sizes = [len(template) for step in self._steps for template in step]
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
        step = frame // self._frames_per_step if self._frames_per_step else 0
        step = min(step, len(self._steps) - 1)
        bank = self._steps[step]
        turn, index = divmod(frame, len(bank))
        if (step, turn) != self._place:
            self._place = (step, turn)
            self._order = self._rng.permutation(len(bank)).tolist()
        return bank[self._order[index]]

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
