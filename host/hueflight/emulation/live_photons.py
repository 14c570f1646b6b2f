# SPDX-License-Identifier: Apache-2.0
"""Photons of a simulated camera whose scene may move and whose delays may drift while it runs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.devices.simulation import Changes
from hueflight.model.instrument import Instrument
from hueflight.simulator.light import expected_rates
from hueflight.simulator.named_scenes import scene as make_scene
from hueflight.simulator.sampling import code_thresholds, draw_bins
from hueflight.simulator.scene import Scene
from hueflight.simulator.simulated_captures import CaptureKind, exposures, frame_packet

BLOCK = 128  #: frames that are drawn at a time; the scene stands still meanwhile
PLACES = 12  #: of the ball on its way from one side to the other
BALL_AWAY_M = 0.55
_ACROSS, _DOWN = 0.75, 0.25  # shares of half the picture


class LivePhotons:
    """Draws packets of a capture, block by block.

    A drift delays every photon by so many bins of the converter, and the fraction of a bin by
    chance; background light has no time that it could change.

    Parameters
    ----------
    kind : CaptureKind
        Kind of the capture: any but ``"bands"``.
    instrument : Instrument
        The instrument to simulate.
    scene : str
        Name of the scene, used where the kind is ``"scene"``.
    distance : float
        Distance of the white target of other kinds, in metres.
    seed : int
        Seed of the photons.

    Attributes
    ----------
    changes : Changes
        What changes from the next block on.
    delay_ps : float
        Present delay by drift.
    """

    def __init__(
        self, kind: CaptureKind, instrument: Instrument, scene: str, distance: float, seed: int
    ) -> None:
        self._instrument, self._name = instrument, scene
        self._moves = kind == "scene"
        looked_at = make_scene(scene, instrument) if self._moves else None
        part = exposures(kind, instrument, scene=looked_at, distance=distance)[0]
        self._scene, self._settings = part.scene, part.settings
        rates = expected_rates(self._scene, instrument, self._settings)
        self._still = code_thresholds(rates)
        self._code_of_bin = np.append(rates.bins.codes, 0).astype(np.uint16)
        self._bin_ps = 1e3 * instrument.sensor.bin_width_ns
        self._rng = np.random.default_rng([seed, 4])
        self._places: dict[int, tuple[slice, NDArray[np.uint32]]] = {}
        self._frame = self._step = 0
        self.changes = Changes()
        self.delay_ps = 0.0

    def packets(self) -> list[bytes]:
        """Return the packets of the next frames."""
        self._drift()
        found = draw_bins(self._thresholds(), BLOCK, self._rng)
        codes = self._code_of_bin[self._delayed(found)]
        made = [
            frame_packet(frame, self._instrument, self._frame + number)
            for number, frame in enumerate(codes)
        ]
        self._frame += BLOCK
        return made

    def _drift(self) -> None:
        per_s = self.changes.drift_ps_per_s
        passed_s = BLOCK / self._instrument.sensor.usual_frame_rate_hz
        self.delay_ps = self.delay_ps + per_s * passed_s if per_s else 0.0

    def _delayed(self, found: NDArray[np.uint16]) -> NDArray[np.uint16]:
        if not self.delay_ps:
            return found
        bins = len(self._code_of_bin) - 1
        whole, part = divmod(self.delay_ps / self._bin_ps, 1.0)
        later = found.astype(np.int64) + int(whole) + (self._rng.random(found.shape) < part)
        return np.where(found < bins, later % bins, bins).astype(np.uint16)

    def _thresholds(self) -> NDArray[np.uint32]:
        if not (self.changes.moving and self._moves):
            return self._still
        self._step += 1
        place = abs((self._step - 1) % (2 * PLACES - 2) - (PLACES - 1))
        if place not in self._places:
            self._places[place] = self._with_ball(place)
        rows, thresholds = self._places[place]
        whole = self._still.copy()
        whole[rows] = thresholds
        return whole

    def _with_ball(self, place: int) -> tuple[slice, NDArray[np.uint32]]:
        """Rows that the ball changes at one of its places, and their thresholds."""
        right, down = (
            float(abs(slopes[-1, -1])) * BALL_AWAY_M for slopes in self._instrument.ray_slopes()
        )
        across = _ACROSS * right * (2 * place / (PLACES - 1) - 1)
        seen = make_scene(self._name, self._instrument, ball=(across, -_DOWN * down, BALL_AWAY_M))
        rows = _changed_rows(self._scene, seen)
        rates = expected_rates(seen, self._instrument, self._settings)
        return rows, code_thresholds(rates.rows(rows))


def _changed_rows(before: Scene, after: Scene) -> slice:
    """Rows from the first to the last in which anything is lit or placed in another way."""
    changed = np.nan_to_num(before.depth) != np.nan_to_num(after.depth)
    changed |= (before.light != after.light).any(axis=0)
    rows = np.flatnonzero(changed.any(axis=1))
    return slice(int(rows[0]), int(rows[-1]) + 1) if rows.size else slice(0, 0)
