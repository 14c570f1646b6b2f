# SPDX-License-Identifier: Apache-2.0
"""Totals of ingest: every packet that was received, and every one that was lost."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hueflight.ingest.kernels import STATE


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestReport:
    """Totals over a stream of packets.

    Attributes
    ----------
    packets : int
        Intact packets of any type, including aborted and repeated ones.
    frames : int
        Frames that were counted.
    photons : int
        Codes other than 0 in these frames.
    damaged : int
        Packets that were recognised but broke a rule or had a wrong CRC.
    missing : int
        Packets that were not received intact, according to gaps in the sequence numbers.
    dropped : int
        Frames dropped by the camera, by its own count, since the first frame received.
    dropped_before : int
        Frames that the camera had dropped in this run before the first frame received.
    aborted : int
        Frames that the camera aborted before their end. They are not counted.
    repeated : int
        Packets received twice in a row. They are counted once.
    restarts : int
        Backward steps of the sequence number, which mean that the device was reset.
    foreign : int
        Intact frames of another geometry or code width. They are not counted.
    skipped_bytes : int
        Bytes that belong to no intact packet.
    masked : int
        Frames from which the camera left out hot pixels (the packets do not state how many).
    roi : int
        Frames from which the camera left out rows outside the region of interest.
    gated : int
        Frames from which the camera left out codes outside the time gate.
    saturated : int
        Frames whose header reports that a counter of the camera has reached its maximum.
    trigger_lost : int
        Frames before which the illuminator missed a trigger.
    test_pattern : int
        Frames that hold a test pattern.
    simulated : int
        Frames that come from a simulated sensor.
    hits : int
        Photons that the packets announce.
    clipped : int
        Counts lost under the overflow policy ``"saturate"``.
    """

    packets: int = 0
    frames: int = 0
    photons: int = 0
    damaged: int = 0
    missing: int = 0
    dropped: int = 0
    dropped_before: int = 0
    aborted: int = 0
    repeated: int = 0
    restarts: int = 0
    foreign: int = 0
    skipped_bytes: int = 0
    masked: int = 0
    roi: int = 0
    gated: int = 0
    saturated: int = 0
    trigger_lost: int = 0
    test_pattern: int = 0
    simulated: int = 0
    hits: int = 0
    clipped: int = 0

    @property
    def miscounted(self) -> int:
        """Photons that were announced but not found; only a faulty encoder makes this non-zero."""
        return self.hits - self.photons

    @property
    def lossless(self) -> bool:
        """Whether every frame since the first one was received and counted."""
        lost = (self.damaged, self.missing, self.dropped, self.aborted, self.foreign)
        return not any((*lost, self.restarts, self.skipped_bytes, self.clipped))

    def as_dict(self) -> dict[str, int]:
        """Return all totals by name, for JSON and metadata.

        Returns
        -------
        dict of str to int
            The attributes by name.
        """
        return asdict(self)

    @classmethod
    def from_state(
        cls, state: NDArray[np.int64], *, photons: int = 0, clipped: int = 0
    ) -> IngestReport:
        """Make a report from the state of a scanner.

        Parameters
        ----------
        state : numpy.ndarray, int64
            State of the scanner, in the order of `kernels.STATE`.
        photons : int
            Photons that were counted.
        clipped : int
            Counts that were clipped.

        Returns
        -------
        IngestReport
            The totals.
        """
        seen = state.tolist()
        return cls(
            photons=photons, clipped=clipped, **{name: seen[at] for name, at in _PLACES.items()}
        )


_PLACES = {  #: of the totals in a scanner's state
    field.name: STATE.index(field.name)
    for field in fields(IngestReport)
    if field.name not in ("photons", "clipped")
}
