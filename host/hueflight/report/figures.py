"""Figures of the report: each function draws one of the paper's figures from the findings."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hueflight.analysis import region_spectra
from hueflight.calibration import Calibration
from hueflight.color.display import three_band_rgb, wavelength_colour
from hueflight.fit.correlation import correlate, peak_centroid
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.paper import search_bins
from hueflight.report.experiments import (
    DISTANCES_ROW,
    PROFILE_ROWS,
    Capture,
    Findings,
    scaled_row,
)
from hueflight.report.style import (
    DEPTH_MAP,
    MEASURED,
    SECOND,
    TRUTH,
    label_lines,
    panels,
    pixel_aspect,
    show_plane,
)

SPECTRUM_REGIONS = ("red brick", "green brick", "blue brick", "purple brick", "horse", "saddle")


def histograms_and_correlation(findings: Findings) -> Figure:
    """Fig. 2: reference and image histograms of one pixel, and their cross-correlation."""
    calibration = findings.calibration
    row, col = example_pixel(findings)
    bins = calibration.bins
    reference = calibration.reference[row, col]
    image = bins.in_time_order(findings.main.histogram)[row, col].astype(np.float32)
    search = search_bins(calibration)
    wide = correlate(image[None], reference[None], bins.count - 1)
    near = correlate(image[None], reference[None], search + int(calibration.half_width_bins) + 1)
    lag = peak_centroid(near, search=search, half_width=calibration.half_width_bins)[0]
    width_ns = calibration.bin_width_ns

    figure, ((left, right),) = panels(1, 2, width=10)
    left.step(
        bins.centers_ns, reference, where="mid", color="0.45", linewidth=0.8, label="reference"
    )
    offset = 1.15 * reference.max()
    left.step(
        bins.centers_ns,
        image + offset,
        where="mid",
        label="image (offset)",
        **MEASURED | {"linewidth": 0.8},
    )
    left.set_title(f"a  Histograms of pixel ({row}, {col})")
    label_lines(left, "arrival time / ns", "counts per bin")
    lags_ns = np.arange(-(bins.count - 1), bins.count) * width_ns
    right.plot(lags_ns, wide[0] / wide.max(), color="0.35", linewidth=0.9)
    right.axvspan(-search * width_ns, search * width_ns, color="0.92", zorder=0)
    right.axvline(lag * width_ns, **MEASURED, label=f"centroid {lag * width_ns:.2f} ns")
    right.set_title("b  Cross-correlation; shaded: lags that are searched")
    label_lines(right, "lag / ns", "correlation")
    inset = right.inset_axes((0.70, 0.42, 0.29, 0.42))
    inset.plot(lags_ns, wide[0] / wide.max(), ".-", color="0.35", markersize=3, linewidth=0.6)
    inset.axvline(lag * width_ns, **MEASURED)
    inset.set_xlim(lag * width_ns - 14, lag * width_ns + 14)
    inset.tick_params(labelsize=7)
    return figure


def band_windows(findings: Findings) -> Figure:
    """Fig. 3: the window of bins that belongs to each LED, with its counts."""
    calibration = findings.calibration
    bins = calibration.bins
    row, col = example_pixel(findings)
    counts = bins.in_time_order(findings.main.histogram)[row, col]
    delay_ns = _delay_ns(findings, row, col)
    shift = round(float(calibration.pixel_delay[row, col]) + delay_ns / calibration.bin_width_ns)
    figure, ((axes,),) = panels(width=10, height=3.4)
    axes.step(bins.centers_ns, counts, where="mid", color="0.25", linewidth=0.8)
    top = counts.max()
    for window in calibration.windows:
        band = calibration.instrument.bands[window.band]
        inside = np.arange(window.start, window.stop) + shift
        edges_ns = bins.edges_ns[np.clip([inside[0], inside[-1] + 1], 0, bins.count)]
        total = int(counts[inside % bins.count].sum())
        colour = wavelength_colour(band.wavelength_nm)
        axes.add_patch(
            Rectangle(
                (edges_ns[0], 0), edges_ns[1] - edges_ns[0], 1.02 * top, color=colour, alpha=0.18
            )
        )
        middle = edges_ns.mean()
        axes.annotate(
            f"{band.wavelength_nm:.0f} nm\n{total}", (middle, 1.05 * top), ha="center", fontsize=8
        )
    axes.set_ylim(0, 1.28 * top)
    axes.set_title(f"Windows of the nine LEDs, moved by this pixel's delay; pixel ({row}, {col})")
    label_lines(axes, "arrival time / ns", "counts per bin", legend=False)
    return figure


def reflectance_images(findings: Findings) -> Figure:
    """Fig. 4(a–j): reflectance in every band, and three bands as an RGB picture."""
    image, instrument = findings.main.image, findings.instrument
    aspect = pixel_aspect(instrument)
    count = len(instrument.bands)
    columns = 5
    rows = -(-(count + 1) // columns)
    figure, axes = panels(rows, columns, width=11, height=1.85 * rows)
    top = float(np.nanpercentile(image["reflectance"].values, 98))
    shown = []
    for band, place in zip(range(count), axes.flat, strict=False):
        nm = instrument.bands[band].wavelength_nm
        plane = image["reflectance"].values[:, :, band]
        title = f"{nm:.0f} nm"
        shown.append(show_plane(place, plane, aspect=aspect, limits=(0, top), title=title))
        place.title.set_color(wavelength_colour(nm))
    spare = list(axes.flat)[count:]
    figure.colorbar(shown[0], ax=axes[:, :], label="reflectance", shrink=0.9, pad=0.01)
    rgb = three_band_rgb(image)
    spare[0].imshow(rgb, aspect=aspect, interpolation="nearest")
    spare[0].set_title("RGB 623, 525, 445 nm")
    for place in spare:
        place.axis("off")
    return figure


def spectra_of_regions(findings: Findings) -> Figure:
    """Figs. 4(k) and 5: mean spectra of regions with their true spectra."""
    capture, instrument = findings.main, findings.instrument
    regions = capture.truth.regions
    names = [name for name in SPECTRUM_REGIONS if name in regions and regions[name].any()]
    spectra = region_spectra(capture.image, {name: regions[name] for name in names})
    order = np.argsort(instrument.wavelengths_nm)
    wavelengths = instrument.wavelengths_nm[order]
    figure, axes = panels(2, 3, width=10, height=4.6, sharex=True, sharey=True)
    for name, place in zip(names, axes.flat, strict=False):
        measured = spectra["reflectance"].sel(region=name).values[order]
        error = spectra["reflectance_std"].sel(region=name).values[order]
        truth = capture.truth.reflectance[:, regions[name]].mean(axis=1)[order]
        place.errorbar(
            wavelengths, measured / measured.max(), yerr=error / measured.max(), marker="o",
            markersize=4, capsize=2, label="measured", **MEASURED,
        )  # fmt: skip
        place.plot(wavelengths, truth / truth.max(), marker=".", label="truth", **TRUTH)
        place.set_title(name)
        place.set_ylim(0, 1.15)
    for place in axes[-1]:
        place.set_xlabel("wavelength / nm")
    for place in axes[:, 0]:
        place.set_ylabel("reflectance\n(brightest band = 1)")
    axes[0, 0].legend(fontsize=8)
    return figure


def depth_and_profiles(findings: Findings) -> Figure:
    """Fig. 6: depth map, and depth along two rows with the true depth."""
    capture = findings.main
    aspect = pixel_aspect(findings.instrument)
    figure, ((left, right),) = panels(1, 2, width=10.5, height=3.6)
    shown = show_plane(
        left, capture.image["depth"].values, aspect=aspect, limits=_depth_limits(capture),
        colours=DEPTH_MAP, title="a  Depth",
    )  # fmt: skip
    figure.colorbar(shown, ax=left, label="depth / m", shrink=0.85)
    for paper_row, look in zip(PROFILE_ROWS, (MEASURED, SECOND), strict=True):
        row = scaled_row(paper_row, findings.instrument)
        left.axhline(row, **look)
        right.plot(capture.image["depth"].values[row], label=f"row {row}", **look)
        right.plot(
            capture.truth.depth[row],
            label="truth" if paper_row == PROFILE_ROWS[0] else None,
            **TRUTH,
        )
        dark = np.flatnonzero(~capture.truth.lit[row])
        right.plot(dark, np.full(dark.size, _depth_limits(capture)[0]), "|", color=look["color"])
    low, high = _depth_limits(capture)
    right.set_ylim(low - 0.05, high + 0.15)
    spread = findings.background_row
    right.set_title(
        f"b  Profiles; row {spread.row}: σ = {100 * spread.deviation:.2f} cm "
        f"(bound {100 * spread.bound:.2f} cm); ticks: shadow"
    )
    label_lines(right, "column", "depth / m")
    return figure


def distances(findings: Findings) -> Figure:
    """Fig. 7: depth of a wall and a board at 0.5, 1.0 and 1.5 m."""
    aspect = pixel_aspect(findings.instrument)
    captures = findings.distances
    figure, axes = panels(2, len(captures), width=11, height=5)
    for column, (distance, capture) in enumerate(captures.items()):
        shown = show_plane(
            axes[0, column], capture.image["depth"].values, aspect=aspect,
            limits=_depth_limits(capture), colours=DEPTH_MAP, title=f"scene at {distance} m",
        )  # fmt: skip
        figure.colorbar(shown, ax=axes[0, column], shrink=0.8, label="depth / m")
        row = scaled_row(DISTANCES_ROW, findings.instrument)
        axes[0, column].axhline(row, **MEASURED)
        axes[1, column].plot(capture.image["depth"].values[row], label=f"row {row}", **MEASURED)
        axes[1, column].plot(capture.truth.depth[row], label="truth", **TRUTH)
        low, high = _depth_limits(capture)
        axes[1, column].set_ylim(low - 0.1, high + 0.2)
        label_lines(axes[1, column], "column", "depth / m", legend=column == 0)
    return figure


def frame_numbers(findings: Findings) -> Figure:
    """Fig. 8: reflectance at 445 nm from different numbers of frames."""
    aspect = pixel_aspect(findings.instrument)
    band = int(np.argmin(np.abs(findings.instrument.wavelengths_nm - 445)))
    figure, axes = panels(1, len(findings.frame_series), width=11, height=2.5)
    for place, (frames, capture) in zip(axes.flat, findings.frame_series.items(), strict=True):
        plane = capture.image["reflectance"].values[:, :, band]
        top = float(np.nanpercentile(plane, 98)) if np.isfinite(plane).any() else 1.0
        show_plane(place, plane, aspect=aspect, limits=(0, top), title=f"{frames} frames")
    return figure


def ranging(findings: Findings) -> Figure:
    """Fig. 9: measured distance of a plane with codes of 55 ps, and the residual."""
    series = findings.ranging
    figure, (upper, lower) = panels(2, 1, width=7.5, height=4.4, sharex=True, height_ratios=[2, 1])
    upper[0].plot(series.truth, series.measured, "o", markersize=4, color=MEASURED["color"])
    upper[0].plot(series.truth, series.truth, **TRUTH)
    upper[0].set_ylabel("measured / m")
    upper[0].set_title(f"σ of the residual {100 * series.deviation:.2f} cm; shaded: ± bound")
    lower[0].fill_between(
        series.truth, -100 * series.bound, 100 * series.bound, color="0.88", linewidth=0
    )
    lower[0].axhline(0, **TRUTH)
    lower[0].plot(series.truth, 100 * series.residual, "o", markersize=4, color=MEASURED["color"])
    label_lines(lower[0], "distance / m", "residual / cm", legend=False)
    return figure


def scene_truth(findings: Findings) -> Figure:
    """Fig. 1(b): the scene in front of the camera, and its true depth."""
    truth = findings.main.truth
    aspect = pixel_aspect(findings.instrument)
    bands = [int(np.argmin(np.abs(truth.wavelengths_nm - nm))) for nm in (623, 525, 445)]
    rgb = np.nan_to_num(np.moveaxis(truth.reflectance[bands], 0, -1))
    figure, ((left, right),) = panels(1, 2, width=9, height=3.2)
    left.imshow(np.clip(rgb, 0, 1) ** (1 / 2.2), aspect=aspect, interpolation="nearest")
    left.set_title("a  The scene, evenly lit")
    left.axis("off")
    shown = show_plane(right, truth.depth, aspect=aspect, colours=DEPTH_MAP, title="b  True depth")
    figure.colorbar(shown, ax=right, label="depth / m", shrink=0.85)
    return figure


def example_pixel(findings: Findings) -> tuple[int, int]:
    """Row and column of a usable pixel on the lit board, in a row of the paper's Fig. 6."""
    row = scaled_row(PROFILE_ROWS[0], findings.instrument)
    truth = findings.main.truth
    good = (
        findings.calibration.usable[row]
        & truth.lit[row]
        & np.isclose(truth.depth[row], np.nanmax(truth.depth[row]))
        & np.isfinite(findings.main.image["depth"].values[row])
    )
    candidates = np.flatnonzero(good)
    return row, int(candidates[candidates.size // 2])


def _depth_limits(capture: Capture) -> tuple[float, float]:
    """Limits of a depth axis that leave some room around the true depths, m."""
    truth = capture.truth.depth
    return float(np.nanmin(truth)) - 0.05, float(np.nanmax(truth)) + 0.08


def _delay_ns(findings: Findings, row: int, col: int) -> float:
    """Delay of a pixel's light relative to its reference, from the measured depth, ns."""
    calibration: Calibration = findings.calibration
    along = float(findings.main.image["depth"].values[row, col]) - calibration.distance
    cosine = calibration.instrument.ray_cosine()[row, col]
    return 2 * along / cosine / SPEED_OF_LIGHT_M_PER_NS
