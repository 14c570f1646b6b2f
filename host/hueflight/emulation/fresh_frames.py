# SPDX-License-Identifier: Apache-2.0
"""New photons for every frame, drawn by a process of their own while the camera runs."""

from __future__ import annotations

import multiprocessing
import random
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from multiprocessing.connection import Connection

from hueflight.devices.errors import DeviceError, DeviceGoneError
from hueflight.devices.illumination import CaptureKind
from hueflight.devices.simulation import Changes
from hueflight.emulation.child_process import take_ordinary_priority
from hueflight.emulation.frame_bank import draw_packets
from hueflight.emulation.frame_template import Template
from hueflight.emulation.live_photons import LivePhotons
from hueflight.model.instrument import Instrument

BATCH = 32  #: frames in one message
AHEAD = 960  #: frames that may wait for the camera
RECENT = 480  #: frames of which one is repeated if none waits
FIRST_S = 300.0  #: longest time until the first frames come: the scene is computed before
#: pixels of all frames in a second up to which one core draws them in time (measured: 24 million)
MOST_PIXELS_PER_S = 13e6


class FreshFrames:
    """Frames with photons of their own, in the place of a `FrameBank`.

    Parameters
    ----------
    kind : CaptureKind
        Kind of the capture.
    instrument : Instrument
        The instrument to simulate.
    scene : str
        Name of the scene, used where the kind is ``"scene"``.
    distance : float
        Distance of the white target, in metres.
    seed : int
        Seed of the photons.
    frames : int
        Number of frames of each LED of a capture of kind ``"bands"``.
    changes : Changes
        What changes in front of the camera.

    Attributes
    ----------
    kind : CaptureKind
        Kind of the capture.
    repeated : int
        Frames that were repeated because the next one was not drawn in time.
    delay_ps : float
        Delay of LED light by drift, of the newest frames.

    Raises
    ------
    DeviceError
        If no frames come.
    """

    def __init__(
        self,
        kind: CaptureKind,
        instrument: Instrument,
        /,
        *,
        scene: str,
        distance: float,
        seed: int,
        frames: int = 0,
        changes: Changes | None = None,
    ) -> None:
        self.kind: CaptureKind = kind
        self.repeated, self.delay_ps = 0, 0.0
        self._fresh: deque[Template] = deque()
        self._recent: deque[Template] = deque(maxlen=RECENT)
        self._changed = threading.Condition()
        self._ended = False
        self._rng = random.Random(seed)
        context = multiprocessing.get_context("spawn")
        self._receiver, sender = context.Pipe()
        seen = (kind, instrument.to_json(), scene, distance)
        self._process = context.Process(
            target=_send_frames,
            args=(sender, *seen, frames, seed, changes or Changes()),
            daemon=True,
        )
        self._process.start()
        sender.close()  # so that the end of the process is the end of the stream
        threading.Thread(target=self._receive, name="photons", daemon=True).start()
        with self._changed:
            self._changed.wait_for(lambda: self._fresh or self._ended, FIRST_S)
            if not self._fresh:
                raise DeviceError(
                    "simulated instrument: the process that draws photons sent none; its error is "
                    "in the log"
                )

    def template(self, frame: int, /) -> Template:
        """Return the next frame, or an earlier one if none is drawn yet.

        Where LEDs fire one at a time, it waits instead: each of their frames has its place.

        Parameters
        ----------
        frame : int
            Number of the frame in the run; frames follow one another.

        Returns
        -------
        Template
            The frame.

        Raises
        ------
        DeviceGoneError
            If the process that draws photons has ended.
        """
        with self._changed:
            if self.kind == "bands":
                self._changed.wait_for(lambda: self._fresh or self._ended, FIRST_S)
            if self._fresh:
                self._recent.append(self._fresh.popleft())
                self._changed.notify_all()
                return self._recent[-1]
            if self._ended and self.kind != "bands":
                raise DeviceGoneError("simulated instrument: the process that draws photons ended")
            self.repeated += 1
            return self._rng.choice(self._recent)

    def change(self, changes: Changes, /) -> None:
        """Let the scene move or delays drift; frames that are drawn already are not used.

        Parameters
        ----------
        changes : Changes
            What changes in front of the camera.
        """
        with suppress(OSError):  # the process has ended, which the next frame says
            self._receiver.send(changes)
        with self._changed:
            if not self._recent and self._fresh:
                self._recent.append(self._fresh[0])  # something to repeat until the next ones come
            self._fresh.clear()
            self._changed.notify_all()

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._process.terminate()
        self._process.join()

    def _receive(self) -> None:
        try:
            while not self._ended:
                delay_ps, packets = self._receiver.recv()
                templates = [Template(packet) for packet in packets]
                with self._changed:
                    self.delay_ps = delay_ps
                    self._fresh.extend(templates)
                    self._changed.notify_all()
                    self._changed.wait_for(lambda: self._ended or len(self._fresh) < AHEAD)
        except (EOFError, OSError):
            pass  # the process has ended
        with self._changed:
            self._ended = True
            self._changed.notify_all()


def _send_frames(
    connection: Connection,
    kind: CaptureKind,
    instrument_json: str,
    scene: str,
    distance: float,
    frames: int,
    seed: int,
    changes: Changes,
) -> None:
    """Draw frames as fast as they are taken, until nobody takes them."""
    take_ordinary_priority()
    try:
        if kind == "bands":
            packets = draw_packets(kind, instrument_json, scene, distance, frames, seed)
            for batch in batched(packets, BATCH):
                connection.send((0.0, batch))
            return
        instrument = Instrument.from_json(instrument_json)
        photons = LivePhotons(kind, instrument, scene, distance, seed)
        photons.changes = changes
        while True:
            while connection.poll():
                photons.changes = connection.recv()
            for batch in batched(photons.packets(), BATCH):
                connection.send((photons.delay_ps, batch))
    except (EOFError, OSError, KeyboardInterrupt):
        return  # the camera is closed


def batched(packets: Iterable[bytes], size: int, /) -> Iterator[list[bytes]]:
    """Yield packets in lists.

    Parameters
    ----------
    packets : iterable of bytes
        The packets.
    size : int
        Number in each list; the last one may have fewer.

    Yields
    ------
    list of bytes
        The next packets.
    """
    rest = iter(packets)
    while batch := list(islice(rest, size)):
        yield batch
