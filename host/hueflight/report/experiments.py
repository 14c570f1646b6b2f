# SPDX-License-Identifier: Apache-2.0
"""The paper's experiments, carried out with the simulated instrument.

Each experiment returns a frozen dataclass with the measured values, the true ones and, where there
is one, the Cramér–Rao bound. `figures` draws them.
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
from hueflight.reconstruction.entry_point import reconstruct

REFERENCE_DISTANCE_M = 0.40  #: white paper in front of the camera, paper section 3
DISTANCES_M = (0.5, 1.0, 1.5)  #: distances of the scene in the paper's Fig. 7
PAPER_ROWS = 192  #: rows of the sensor to which the paper's row numbers refer
PROFILE_ROWS = (139, 56)  #: rows of the paper's Fig. 6
DISTANCES_ROW = 80  #: a row that crosses the window of the wall at all three distances
FEW_FRAMES = 100  #: of the capture that stands for depth from few photons
POOLED_BELOW_FRAMES = 2000  #: captures with fewer frames are pooled over neighbors
RANGE_PHOTONS = 10_000  #: signal photons of one range measurement of Fig. 9
#: detections per period at 1 m in Fig. 9; few, as the first-photon sensor distorts bright pulses
RANGE_DETECTIONS = 5e-4


@dataclass(frozen=True)
class Capture:
    """A capture of a scene, with its truth and the images reconstructed from it.

    Attributes
    ----------
    scene : Scene
        Scene in front of the camera.
    truth : Truth
        True depth and reflectance of the scene.
    histogram : ndarray of uint16 or uint32, shape (row, col, code)
        Number of exposures with each code.
    image : Dataset
        Image reconstructed by the paper's method.
    joint : Dataset
        Image reconstructed by the joint fit; by the pooled method where frames are few.
    frames : int
        Number of exposures.
    """

    scene: simulator.Scene
    truth: simulator.Truth
    histogram: NDArray[np.unsignedinteger]
    image: xr.Dataset
    joint: xr.Dataset
    frames: int

    @property
    def images(self) -> tuple[xr.Dataset, xr.Dataset]:
        """The image of the paper's method, and that of ours."""
        return self.image, self.joint


@dataclass(frozen=True)
class WireCheck:
    """Comparison of codes that were sent as packets with the histogram decoded from them.

    Attributes
    ----------
    frames : int
        Number of frames decoded.
    bytes_per_frame : float
        Mean size of a frame's packet, bytes.
    photons : int
        Number of photons decoded.
    identical : bool
        Whether the decoded histogram equals the one counted from the codes themselves.
    encode_seconds, decode_seconds : float
        Time for writing and for reading all packets, s.
    """

    frames: int
    bytes_per_frame: float
    photons: int
    identical: bool
    encode_seconds: float
    decode_seconds: float


@dataclass(frozen=True)
class RangeSeries:
    """Distances measured by one pixel with fine bins in front of a plane (Fig. 9).

    Attributes
    ----------
    truth : ndarray of float, shape (distance,)
        True distance of the plane, m.
    measured, joint : ndarray of float, shape (distance,)
        Distance measured by the paper's method and by the joint fit, m.
    bound : ndarray of float, shape (distance,)
        Cramér–Rao bound of the standard deviation, m.
    """

    truth: NDArray[np.float64]
    measured: NDArray[np.float64]
    joint: NDArray[np.float64]
    bound: NDArray[np.float64]

    @property
    def deviation(self) -> float:
        """Standard deviation of the paper's method about the true distance, m."""
        return float(np.std(self.measured - self.truth))

    @property
    def joint_deviation(self) -> float:
        """Standard deviation of the joint fit about the true distance, m."""
        return float(np.std(self.joint - self.truth))


@dataclass(frozen=True)
class DepthRow:
    """Statistics of the depth along one row of plain background.

    Attributes
    ----------
    row : int
        Row of the image.
    deviation : float
        Standard deviation of measured minus true depth, m.
    bias : float
        Mean of measured minus true depth, m.
    bound : float
        Cramér–Rao bound of the standard deviation, m: root of the mean square over the pixels.
    photons : float
        Median number of signal photons per pixel.
    """

    row: int
    deviation: float
    bias: float
    bound: float
    photons: float


@dataclass(frozen=True)
class Findings:
    """Results of all experiments of the report.

    Attributes
    ----------
    instrument : Instrument
        Simulated instrument.
    calibration : Calibration
        Calibration from simulated reference, one-LED, dark and flat captures.
    main : Capture
        Scene of the paper's Fig. 1 from all frames.
    background_row, joint_row : DepthRow
        Depth along a row of the board in `main`, by the paper's method and by the joint fit.
    distances : dict of float to Capture
        Scene of the paper's Fig. 7, by distance in metres.
    frame_series : dict of int to Capture
        Scene of the paper's Fig. 1, by number of frames in increasing order.
    ranging : RangeSeries
        Distances measured by a pixel with fine bins.
    wire : WireCheck
        Comparison of codes before and after their transfer as packets.
    """

    instrument: Instrument
    calibration: Calibration
    main: Capture
    background_row: DepthRow
    joint_row: DepthRow
    distances: dict[float, Capture]
    frame_series: dict[int, Capture]
    ranging: RangeSeries
    wire: WireCheck


def run_all(instrument: Instrument, *, frames: int, seed: int, progress: Progress) -> Findings:
    """Carry out all experiments of the report.

    Parameters
    ----------
    instrument : Instrument
        Instrument to simulate; Fig. 9 uses the preset `fine` instead.
    frames : int
        Number of exposures of the main captures and of the calibration.
    seed : int
        Seed of the imperfections and of the photon noise.
    progress : Progress
        Display of the progress, advanced after each experiment.

    Returns
    -------
    Findings
        Results of all experiments.
    """
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
        background_row=depth_row(main, main.image, calibration),
        joint_row=depth_row(main, main.joint, calibration),
        distances=distances,
        frame_series=dict(sorted(series.items())),
        ranging=ranging,
        wire=wire,
    )


def reference_calibration(
    instrument: Instrument, *, frames: int, settings: simulator.SimulationSettings
) -> Calibration:
    """Calibrate with simulated captures of a white sheet at 0.40 m, also one LED at a time."""
    captured = {
        kind: simulator.simulate_capture(kind, instrument, frames=frames, settings=settings)
        for kind in ("reference", "bands", "dark", "flat")
    }
    return calibrate(
        captured["reference"],
        instrument,
        distance=REFERENCE_DISTANCE_M,
        bands=captured["bands"],
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
    """Simulate the capture of a scene and reconstruct it by both methods.

    Parameters
    ----------
    name : str
        Name of the scene, one of `hueflight.simulator.scenes()`.
    calibration : Calibration
        Calibration of the instrument that looks at the scene.
    frames : int
        Number of exposures.
    settings : SimulationSettings
        Light level and imperfections of the instrument.
    seed : int
        Seed of the photon noise.
    range_correction : bool
        Whether reflectance is corrected for the distance of each pixel.
    **layout : float, int or str
        Options of the scene.

    Returns
    -------
    Capture
        Scene, truth, histogram and images.
    """
    instrument = calibration.instrument
    scene = simulator.scene(name, instrument, **layout)
    histogram = simulator.simulate_histogram(
        scene, instrument, frames=frames, settings=settings, seed=seed
    )
    paper, joint = (
        reconstruct(histogram, calibration, method=method, range_correction=range_correction)
        for method in ("paper", "pooled" if frames < POOLED_BELOW_FRAMES else "joint")
    )
    return Capture(scene, scene.truth(instrument), histogram, paper, joint, frames)


def scaled_row(paper_row: int, instrument: Instrument) -> int:
    """Row of an instrument's image at the same relative height as a row of the paper's sensor."""
    return paper_row * instrument.image_shape[0] // PAPER_ROWS


def depth_row(capture: Capture, image: xr.Dataset, calibration: Calibration) -> DepthRow:
    """Compare the depth along a row of lit background with the truth and the bound (Fig. 6).

    Parameters
    ----------
    capture : Capture
        Capture of the scene of Fig. 1.
    image : Dataset
        One of its images.
    calibration : Calibration
        Calibration with which the image was reconstructed.

    Returns
    -------
    DepthRow
        Statistics over the usable pixels of the row that see the board.
    """
    row = scaled_row(PROFILE_ROWS[0], calibration.instrument)
    depth = image["depth"].values[row]
    truth, lit = capture.truth.depth[row], capture.truth.lit[row]
    good = np.isfinite(depth) & lit & np.isclose(truth, np.nanmax(truth))
    error = depth[good] - truth[good]
    light = capture.joint  # whose background is free of the pulses' tails
    background = light["background"].values[row][good] * calibration.bins.count
    photons = light["photons"].values[row][good] - background
    bounds = [
        depth_bound(
            calibration,
            photons=float(signal),
            reflectance=reflectance,
            background=float(noise),
            depth=float(distance),
        )
        for signal, reflectance, noise, distance in zip(
            photons, capture.truth.reflectance[:, row][:, good].T, background, truth[good],
            strict=True,
        )
    ]  # fmt: skip
    return DepthRow(
        row=row,
        deviation=float(np.std(error)),
        bias=float(np.mean(error)),
        bound=float(np.sqrt(np.mean(np.square(bounds)))),
        photons=float(np.median(photons)),
    )


def range_series(instrument: Instrument, *, seed: int, steps: int = 25) -> RangeSeries:
    """Measure the distance of a plane moved from 0.1 to 2.5 m (Fig. 9).

    Parameters
    ----------
    instrument : Instrument
        Instrument with a single fast detector.
    seed : int
        Seed of the photon noise.
    steps : int
        Number of distances.

    Returns
    -------
    RangeSeries
        True and measured distances, and the bound.
    """
    settings = simulator.SimulationSettings.ideal(white_detections=RANGE_DETECTIONS)
    scene = simulator.scene("plane", instrument, distance=1.0)
    per_exposure = float(simulator.expected_rates(scene, instrument, settings).detections().mean())
    frames = int(RANGE_PHOTONS / per_exposure)
    reference = simulator.simulate_histogram(
        scene, instrument, frames=50 * frames, settings=settings, seed=seed
    )
    calibration = calibrate(reference, instrument, distance=1.0)
    truth = np.linspace(0.1, 2.5, steps)
    measured, joint, bound = np.empty((3, steps))
    for number, distance in enumerate(truth):
        target = simulator.scene("plane", instrument, distance=float(distance))
        # the same number of photons at all distances, so that only the converter differs
        target_frames = max(1, int(frames * distance**2))
        counts = simulator.simulate_histogram(
            target, instrument, frames=target_frames, settings=settings, seed=seed + 1 + number
        )
        image = reconstruct(counts, calibration, method="paper")
        measured[number] = image["depth"].item()
        joint[number] = reconstruct(counts, calibration, method="joint")["depth"].item()
        bound[number] = depth_bound(
            calibration, photons=image["photons"].item(), depth=float(distance)
        )
    return RangeSeries(truth, measured, joint, bound)


def wire_check(
    scene: simulator.Scene,
    instrument: Instrument,
    *,
    settings: simulator.SimulationSettings,
    frames: int,
    seed: int,
) -> WireCheck:
    """Draw frames one by one, encode them as packets, decode these and compare the counts.

    Parameters
    ----------
    scene : Scene
        Scene in front of the camera.
    instrument : Instrument
        Instrument that looks at the scene.
    settings : SimulationSettings
        Light level and imperfections of the instrument.
    frames : int
        Number of frames.
    seed : int
        Seed of the photon noise.

    Returns
    -------
    WireCheck
        Whether the counts are equal, sizes and times.
    """
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
