"""What ingest has seen: every packet that came, every one that did not."""

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
    packets : intact packets of any type, aborted and repeated ones included.
    frames : frames counted.
    photons : codes other than 0 in them.
    damaged : packets that were recognised and broke a rule, or whose CRC was wrong.
    missing : packets that never came intact, by gaps in the sequence numbers.
    dropped : frames that the camera says it dropped, since the first frame seen.
    dropped_before : frames that the camera had dropped in this run before the first frame seen.
    aborted : frames that the camera gave up in the middle; not counted.
    repeated : packets that came twice in a row; counted once.
    restarts : steps back of the sequence number: the device was reset.
    foreign : intact frames of another geometry or code width; not counted.
    skipped_bytes : bytes that belong to no intact packet.
    masked, roi, gated : frames of which the camera left out hot pixels, rows outside the region
        of interest, codes outside the time gate. The wire says that it was so, not for how many.
    saturated : frames in whose header a counter of the camera stands at its end.
    trigger_lost : frames before which the illuminator missed a trigger.
    test_pattern, simulated : frames that are not from a sensor.
    hits : photons that the packets announce.
    clipped : counts that the overflow policy ``"saturate"`` let go.
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
        """Photons announced but not found; other than 0 only if an encoder is faulty."""
        return self.hits - self.photons

    @property
    def lossless(self) -> bool:
        """Whether every frame since the first one seen arrived and was counted."""
        lost = (self.damaged, self.missing, self.dropped, self.aborted, self.foreign)
        return not any((*lost, self.restarts, self.skipped_bytes, self.clipped))

    def as_dict(self) -> dict[str, int]:
        """All totals by name, for JSON and metadata."""
        return asdict(self)

    @classmethod
    def from_state(
        cls, state: NDArray[np.int64], *, photons: int = 0, clipped: int = 0
    ) -> IngestReport:
        """Totals of a scanner's state and what was counted."""
        seen = state.tolist()
        return cls(
            photons=photons, clipped=clipped, **{name: seen[at] for name, at in _PLACES.items()}
        )


_PLACES = {  #: of the totals in a scanner's state
    field.name: STATE.index(field.name)
    for field in fields(IngestReport)
    if field.name not in ("photons", "clipped")
}
