# SPDX-License-Identifier: Apache-2.0
"""Real photons: 340 × 340 pixels of a mannequin's face, scanned one after another.

The data state the arrival times of photons in steps of 8 ps, but not the shape of the laser pulse,
which is estimated from the photons, aligned by the depth found so far.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from _real_photons import PHOTON_DATA, laser_calibration
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.ndimage import uniform_filter

import hueflight as hf
from hueflight.calibration import Calibration
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.joint import search_range_ns
from hueflight.reconstruction.pooled.estimate import photons_of
from hueflight.reconstruction.pooled.kernels import lag_likelihood
from hueflight.reconstruction.pooled.tables import tables_for

FACE = PHOTON_DATA / "data_face.mat"
STEP_NS = 0.008
FIRST, CODES, GROUP = 3328, 256, 4  #: the stretch of time that is looked at, in codes of 4 steps
PULSE_NS = 0.5  #: where the pulse of distance 0 is put
DEPTH_RANGE = (0.15, 1.0)
ROUNDS = 2  #: of pulse and depth in turn
PERIOD_NS = STEP_NS * GROUP * CODES


def face_depths() -> tuple[NDArray[np.float64], xr.Dataset, float]:
    """Depth (row, col) by the log-matched filter, the pooled image, and photons per pixel."""
    counts, calibration, photons = face_capture()
    image = hf.reconstruct(counts, calibration, method="pooled", depth_range=DEPTH_RANGE)
    return matched_depths(counts, calibration, DEPTH_RANGE), image, photons


def face_capture() -> tuple[NDArray[np.uint16], Calibration, float]:
    """Histograms (row, col, code), a calibration from the same photons, and photons per pixel."""
    times = loadmat(FACE)["Ts"]
    rows, cols = times.shape
    each = [[cell.ravel().astype(np.int64) for cell in row] for row in times]
    sizes = np.array([[cell.size for cell in row] for row in each])
    arrivals = np.concatenate([cell for row in each for cell in row])
    owner = np.repeat(np.arange(sizes.size), sizes.ravel())
    code = (arrivals - FIRST) // GROUP
    inside = (code >= 0) & (code < CODES)
    arrivals, owner, code = arrivals[inside], owner[inside], code[inside]
    counts = np.zeros((rows * cols, CODES), np.uint16)
    np.add.at(counts, (owner, code), 1)
    counts = counts.reshape(rows, cols, CODES)
    instrument = _instrument(rows, cols)
    arrival_ns = (arrivals - FIRST + 0.5) * STEP_NS

    around = uniform_filter(counts.astype(np.float32), (5, 5, 5))
    delay_ns = around.argmax(axis=-1) * (STEP_NS * GROUP)
    calibration = _calibration(instrument, arrival_ns - delay_ns.ravel()[owner])
    for _ in range(ROUNDS - 1):
        image = hf.reconstruct(counts, calibration, method="pooled", depth_range=DEPTH_RANGE)
        delay_ns = PULSE_NS + 2 * image.depth.values / SPEED_OF_LIGHT_M_PER_NS
        delay_ns = np.nan_to_num(delay_ns, nan=PULSE_NS)
        calibration = _calibration(instrument, arrival_ns - delay_ns.ravel()[owner])
    return counts, calibration, float(sizes.mean())


def _instrument(rows: int, cols: int) -> hf.Instrument:
    return hf.Instrument.from_toml(f"""
        name = "scanned face"
        [sensor]
        rows = {rows}
        cols = {cols}
        code_bits = 8
        bin_width_ns = {STEP_NS * GROUP}
        [timing]
        period_ns = {PERIOD_NS}
        latency_ns = {PULSE_NS}
        [[bands]]
        name = "laser"
        wavelength_nm = 640
        pulse_fwhm_ns = 0.3
    """)


def _calibration(instrument: hf.Instrument, since_ns: NDArray[np.float64]) -> Calibration:
    """What times since the pulse say of its shape."""
    knots = CODES
    place = np.remainder(since_ns + PULSE_NS, PERIOD_NS)
    shape = np.histogram(place, np.linspace(0, PERIOD_NS, knots + 1))[0].astype(float)
    shape -= np.median(shape)  # light that is there all the time
    shape[np.arange(knots) * PERIOD_NS / knots > PULSE_NS + 1.1] = 0
    return laser_calibration(instrument, shape)


def matched_depths(
    counts: NDArray[np.unsignedinteger], calibration: Calibration, depth_range: tuple[float, float]
) -> NDArray[np.float64]:
    """Depth of the highest correlation with the logarithm of the pulse, each pixel alone."""
    depths, score = matched_scores(counts, calibration, depth_range)
    return np.where(counts.any(axis=-1), depths[score.argmax(axis=-1)], np.nan)


def matched_scores(
    counts: NDArray[np.unsignedinteger], calibration: Calibration, depth_range: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Depths, and the correlation (row, col, depth) with the logarithm of the pulse there."""
    search_ns = search_range_ns(calibration, depth_range)
    tables = tables_for(calibration, search_ns)
    pulse = 0.9 * tables.shares[:, 0] * tables.period_ns + 0.1
    first, last = (int(bound * tables.cells_per_ns) for bound in search_ns)
    lags = np.arange(first, last, 4, dtype=np.int32)
    score = lag_likelihood(
        photons_of(counts, calibration, tables),
        np.log(pulse).astype(np.float32),
        tables.cells_per_ns,
        lags,
    )
    depths = lags / tables.cells_per_ns * SPEED_OF_LIGHT_M_PER_NS / 2
    return depths, score.reshape(*counts.shape[:2], lags.size)
