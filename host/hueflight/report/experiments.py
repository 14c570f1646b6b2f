"""The paper's experiments, carried out by the simulated instrument.

Each returns a frozen dataclass with what was measured, the truth beside it and the bound; the
figures only draw them.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import hueflight_protocol as protocol
from hueflight import simulator
from hueflight.calibration import Calibration, calibrate
from hueflight.ingest import accumulate
from hueflight.model.instrument import Instrument
from hueflight.progress import Progress, task
from hueflight.reconstruction.bounds import depth_bound
from hueflight.reconstruction.reconstruct import reconstruct

REFERENCE_DISTANCE_M = 0.40  #: white paper in front of the camera, paper section 3
DISTANCES_M = (0.5, 1.0, 1.5)  #: of the paper's Fig. 7
PAPER_ROWS = 192  #: of the sensor whose rows the paper numbers
PROFILE_ROWS = (139, 56)  #: rows of the paper's Fig. 6
DISTANCES_ROW = 80  #: crosses the window of the wall at all three
RANGE_PHOTONS = 10_000  #: signal photons of one range measurement of Fig. 9
RANGE_DETECTIONS = 5e-4  #: per period at 1 m: dim, as one photon a period distorts bright pulses


@dataclass(frozen=True)
class Capture:
    """A scene, what was counted of it, and what came out."""

    scene: simulator.Scene
    truth: simulator.Truth
    histogram: NDArray[np.unsignedinteger]
    image: xr.Dataset
    frames: int


@dataclass(frozen=True)
class WireCheck:
    """Frames sent as packets and counted again, against the codes that went in."""

    frames: int
    bytes_per_frame: float
    photons: int
    identical: bool
    encode_seconds: float
    decode_seconds: float


@dataclass(frozen=True)
class RangeSeries:
    """One pixel with fine bins in front of a plane at many distances (Fig. 9)."""

    truth: NDArray[np.float64]
    measured: NDArray[np.float64]
    bound: NDArray[np.float64]

    @property
    def residual(self) -> NDArray[np.float64]:
        """Measured minus true distance, m."""
        return self.measured - self.truth

    @property
    def deviation(self) -> float:
        """Standard deviation of the residual, m."""
        return float(np.std(self.residual))


@dataclass(frozen=True)
class DepthRow:
    """Spread of the depth along one row of plain background, beside the bound."""

    row: int
    deviation: float
    bias: float
    bound: float
    photons: float


@dataclass(frozen=True)
class Findings:
    """Everything that the report shows."""

    instrument: Instrument
    calibration: Calibration
    main: Capture
    background_row: DepthRow
    distances: dict[float, Capture]
    frame_series: dict[int, Capture]
    ranging: RangeSeries
    wire: WireCheck


def run_all(instrument: Instrument, *, frames: int, seed: int, progress: Progress) -> Findings:
    """All experiments of the report, about ten captures."""
    with task(progress, "experiments", 10):
        settings = simulator.SimulationSettings(seed=seed)
        calibration = reference_calibration(instrument, frames=frames, settings=settings)
        progress.advance()
        main = capture(
            "fig1",
            calibration,
            frames=frames,
            settings=settings,
            seed=seed + 1,
            range_correction=True,
        )
        progress.advance()
        distances = {}
        for number, distance in enumerate(DISTANCES_M):
            distances[distance] = capture(
                "fig7",
                calibration,
                frames=frames,
                settings=settings,
                seed=seed + 10 + number,
                distance=distance,
            )
            progress.advance()
        series = {frames: main}
        for number in (10, 100, 1000):
            series[number] = capture(
                "fig1", calibration, frames=number, settings=settings, seed=seed + 20 + number
            )
            progress.advance()
        ranging = range_series(Instrument.load("fine"), seed=seed)
        progress.advance()
        wire = wire_check(main.scene, instrument, settings=settings, frames=200, seed=seed)
        progress.advance()
    return Findings(
        instrument=instrument,
        calibration=calibration,
        main=main,
        background_row=depth_row(main, calibration),
        distances=distances,
        frame_series=dict(sorted(series.items())),
        ranging=ranging,
        wire=wire,
    )


def reference_calibration(
    instrument: Instrument, *, frames: int, settings: simulator.SimulationSettings
) -> Calibration:
    """Calibration from a white sheet at 0.40 m, a dark and a flat capture."""
    captured = {
        kind: simulator.simulate_capture(kind, instrument, frames=frames, settings=settings)
        for kind in ("reference", "dark", "flat")
    }
    return calibrate(
        captured["reference"],
        instrument,
        distance=REFERENCE_DISTANCE_M,
        dark=captured["dark"],
        flat=captured["flat"],
    )


def capture(
    name: str,
    calibration: Calibration,
    *,
    frames: int,
    settings: simulator.SimulationSettings,
    seed: int,
    range_correction: bool = False,
    **layout: Any,
) -> Capture:
    """One scene captured and reconstructed by the paper's method; `layout` goes to the scene."""
    instrument = calibration.instrument
    scene = simulator.scene(name, instrument, **layout)
    histogram = simulator.simulate_histogram(
        scene, instrument, frames=frames, settings=settings, seed=seed
    )
    image = reconstruct(histogram, calibration, method="paper", range_correction=range_correction)
    return Capture(scene, scene.truth(instrument), histogram, image, frames)


def scaled_row(paper_row: int, instrument: Instrument) -> int:
    """The row of an instrument's image at the height of one of the paper's rows."""
    return paper_row * instrument.image_shape[0] // PAPER_ROWS


def depth_row(capture: Capture, calibration: Calibration) -> DepthRow:
    """Depth along a row of lit background against the truth and the bound (Fig. 6)."""
    row = scaled_row(PROFILE_ROWS[0], calibration.instrument)
    depth = capture.image["depth"].values[row]
    truth, lit = capture.truth.depth[row], capture.truth.lit[row]
    good = np.isfinite(depth) & lit & np.isclose(truth, np.nanmax(truth))
    error = depth[good] - truth[good]
    background = capture.image["background"].values[row][good] * calibration.bins.count
    photons = capture.image["photons"].values[row][good] - background
    reflectance = np.nanmean(capture.truth.reflectance[:, row][:, good], axis=1)
    bound = depth_bound(
        calibration,
        photons=float(np.median(photons)),
        reflectance=reflectance,
        background=float(np.median(background)),
        depth=float(np.median(truth[good])),
    )
    return DepthRow(
        row=row,
        deviation=float(np.std(error)),
        bias=float(np.mean(error)),
        bound=bound,
        photons=float(np.median(photons)),
    )


def range_series(instrument: Instrument, *, seed: int, steps: int = 25) -> RangeSeries:
    """A single fast detector in front of a plane moved from 0.1 to 2.5 m (Fig. 9)."""
    settings = simulator.SimulationSettings.ideal(white_detections=RANGE_DETECTIONS)
    scene = simulator.scene("plane", instrument, distance=1.0)
    per_exposure = float(simulator.expected_rates(scene, instrument, settings).detections().mean())
    frames = int(RANGE_PHOTONS / per_exposure)
    reference = simulator.simulate_histogram(
        scene, instrument, frames=50 * frames, settings=settings, seed=seed
    )
    calibration = calibrate(reference, instrument, distance=1.0)
    truth = np.linspace(0.1, 2.5, steps)
    measured, bound = np.empty(steps), np.empty(steps)
    for number, distance in enumerate(truth):
        target = simulator.scene("plane", instrument, distance=float(distance))
        # the same number of photons everywhere: it is the converter that is looked at
        target_frames = max(1, int(frames * distance**2))
        counts = simulator.simulate_histogram(
            target, instrument, frames=target_frames, settings=settings, seed=seed + 1 + number
        )
        image = reconstruct(counts, calibration, method="paper")
        measured[number] = image["depth"].item()
        bound[number] = depth_bound(
            calibration, photons=image["photons"].item(), depth=float(distance)
        )
    return RangeSeries(truth, measured, bound)


def wire_check(
    scene: simulator.Scene,
    instrument: Instrument,
    *,
    settings: simulator.SimulationSettings,
    frames: int,
    seed: int,
) -> WireCheck:
    """Frames drawn one by one, sent as packets, decoded and counted again."""
    blocks = list(
        simulator.simulate_codes(scene, instrument, frames=frames, settings=settings, seed=seed)
    )
    codes = np.concatenate(blocks)
    started = perf_counter()
    packets = [
        protocol.encode_frame(frame, sequence=number, frame=number, timestamp=number)
        for number, frame in enumerate(codes)
    ]
    encoded = perf_counter()
    stream = b"".join(packets)
    counts, report = accumulate(stream, instrument)
    decoded = perf_counter()
    expected = np.zeros(instrument.histogram_shape, counts.dtype)
    row, col = np.indices(instrument.image_shape)
    for frame in codes:
        expected[row, col, frame] += 1
    return WireCheck(
        frames=report.frames,
        bytes_per_frame=len(stream) / frames,
        photons=report.photons,
        identical=bool(np.array_equal(counts, expected)),
        encode_seconds=encoded - started,
        decode_seconds=decoded - encoded,
    )
