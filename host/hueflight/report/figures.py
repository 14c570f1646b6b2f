# SPDX-License-Identifier: Apache-2.0
"""Figures of the report: each function draws one of the paper's figures from the findings."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
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
    FEW_FRAMES,
    POOLED_BELOW_FRAMES,
    PROFILE_ROWS,
    Capture,
    Findings,
    scaled_row,
)
from hueflight.report.style import (
    DEPTH_MAP,
    JOINT,
    MEASURED,
    PAPER,
    TRUTH,
    label_lines,
    panels,
    pixel_aspect,
    show_plane,
)

GLANCE_REGION = "green brick"  #: whose spectrum the first figure shows
SPECTRUM_REGIONS = ("red brick", "green brick", "blue brick", "purple brick", "horse", "saddle")


def at_a_glance(findings: Findings) -> Figure:
    """What goes in and what comes out: counts, depth from few frames, colour and a spectrum."""
    few, main = findings.frame_series[FEW_FRAMES], findings.main
    aspect = pixel_aspect(findings.instrument)
    limits = _depth_limits(few)
    figure, ((pulses, published, ours), (colour, spectrum, truth)) = panels(
        2, 3, width=11.5, height=5.6
    )
    _draw_windows(pulses, findings)
    pulses.set_title("Photons of one pixel, nine colors of light")
    for place, depth, title in (
        (published, few.image["depth"].values, f"Depth, {FEW_FRAMES} frames, published method"),
        (ours, few.joint["depth"].values, f"Depth, the same {FEW_FRAMES} frames, Hueflight"),
        (truth, few.truth.depth, "True depth"),
    ):
        shown = show_plane(
            place, depth, aspect=aspect, limits=limits, colours=DEPTH_MAP, title=title
        )
        figure.colorbar(shown, ax=place, label="depth / m", shrink=0.85)
    colour.imshow(three_band_rgb(main.joint), aspect=aspect, interpolation="nearest")
    colour.set_title(f"Color from three of nine bands, {main.frames} frames")
    colour.axis("off")
    _draw_spectra(spectrum, findings, GLANCE_REGION)
    spectrum.set_title(f"Spectrum of the {GLANCE_REGION}")
    label_lines(spectrum, "wavelength / nm", "reflectance")
    return figure


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
    figure, ((axes,),) = panels(width=10, height=3.4)
    for (low_ns, high_ns), nm, total, top in _draw_windows(axes, findings):
        axes.annotate(
            f"{nm:.0f} nm\n{total}", ((low_ns + high_ns) / 2, 1.05 * top), ha="center", fontsize=8
        )
    axes.set_ylim(top=1.28 * axes.get_ylim()[1])
    row, col = example_pixel(findings)
    axes.set_title(f"Windows of the nine LEDs, moved by this pixel's delay; pixel ({row}, {col})")
    return figure


def reflectance_images(findings: Findings) -> Figure:
    """Fig. 4(a–j): reflectance in every band by both methods, and three bands as an RGB picture."""
    capture, instrument = findings.main, findings.instrument
    aspect = pixel_aspect(instrument)
    count = len(instrument.bands)
    columns = 5
    rows = -(-(count + 1) // columns)
    figure, axes = panels(2 * rows, columns, width=11, height=3.7 * rows)
    top = float(np.nanpercentile(capture.joint["reflectance"].values, 98))
    for half, (name, image) in enumerate((("paper", capture.image), ("joint", capture.joint))):
        places = list(axes[half * rows : (half + 1) * rows].flat)
        shown = []
        for band, place in zip(range(count), places, strict=False):
            nm = instrument.bands[band].wavelength_nm
            plane = image["reflectance"].values[:, :, band]
            title = f"{name}, {nm:.0f} nm" if band == 0 else f"{nm:.0f} nm"
            shown.append(show_plane(place, plane, aspect=aspect, limits=(0, top), title=title))
            place.title.set_color(wavelength_colour(nm))
        figure.colorbar(
            shown[-1], ax=axes[half * rows : (half + 1) * rows, :], label="reflectance", shrink=0.9,
            pad=0.01,
        )  # fmt: skip
        spare = places[count:]
        spare[0].imshow(three_band_rgb(image), aspect=aspect, interpolation="nearest")
        spare[0].set_title("RGB 623, 525, 445 nm")
        for place in spare:
            place.axis("off")
    return figure


def spectra_of_regions(findings: Findings) -> Figure:
    """Figs. 4(k) and 5: mean spectra of regions by both methods, with their true spectra."""
    regions = findings.main.truth.regions
    names = [name for name in SPECTRUM_REGIONS if name in regions and regions[name].any()]
    figure, axes = panels(2, 3, width=10, height=4.6, sharex=True)
    for name, place in zip(names, axes.flat, strict=False):
        _draw_spectra(place, findings, name)
        place.set_title(name)
    for place in axes[-1]:
        place.set_xlabel("wavelength / nm")
    for place in axes[:, 0]:
        place.set_ylabel("reflectance")
    axes[0, 0].legend(fontsize=8)
    return figure


def depth_and_profiles(findings: Findings) -> Figure:
    """Fig. 6: depth maps of both methods, and depth along two rows with the true depth."""
    capture = findings.main
    aspect = pixel_aspect(findings.instrument)
    limits = _depth_limits(capture)
    figure, axes = panels(2, 2, width=10.5, height=6.4)
    results = (
        ("paper", capture.image, PAPER, findings.background_row),
        ("joint", capture.joint, JOINT, findings.joint_row),
    )
    for (name, image, look, _), place in zip(results, axes[:, 0], strict=True):
        shown = show_plane(
            place, image["depth"].values, aspect=aspect, limits=limits, colours=DEPTH_MAP,
            title=f"Depth, {name}",
        )  # fmt: skip
        figure.colorbar(shown, ax=place, label="depth / m", shrink=0.85)
        for paper_row, place in zip(PROFILE_ROWS, axes[:, 1], strict=True):
            row = scaled_row(paper_row, findings.instrument)
            place.plot(image["depth"].values[row], label=name, **look)
    deviation = capture.joint["depth_std"].values
    for paper_row, place in zip(PROFILE_ROWS, axes[:, 1], strict=True):
        row = scaled_row(paper_row, findings.instrument)
        for left in axes[:, 0]:
            left.axhline(row, color="white", linewidth=0.7)
        depth = capture.joint["depth"].values[row]
        place.fill_between(
            np.arange(depth.size), depth - deviation[row], depth + deviation[row],
            color=JOINT["color"], alpha=0.2, linewidth=0, label="joint ± stated deviation",
        )  # fmt: skip
        place.plot(capture.truth.depth[row], label="truth", **TRUTH)
        dark = np.flatnonzero(~capture.truth.lit[row])
        place.plot(dark, np.full(dark.size, limits[0] - 0.03), "|", color="0.4")
        place.set_ylim(limits[0] - 0.05, limits[1] + 0.15)
        place.set_title(f"Row {row}")
        label_lines(place, "column", "depth / m", legend=paper_row == PROFILE_ROWS[0])
    spreads = ", ".join(f"{name} {100 * row.deviation:.2f} cm" for name, _, _, row in results)
    bound = 100 * findings.joint_row.bound
    axes[0, 1].set_title(f"Row {findings.joint_row.row}: σ {spreads}, bound {bound:.2f} cm")
    return figure


def uncertainty_and_flags(findings: Findings) -> Figure:
    """The joint fit's own statements: deviation of depth, and pixels with flags."""
    image, truth = findings.main.joint, findings.main.truth
    aspect = pixel_aspect(findings.instrument)
    figure, ((left, middle, right),) = panels(1, 3, width=11, height=3.0)
    deviation = 100 * image["depth_std"].values
    shown = show_plane(
        left, deviation, aspect=aspect, limits=(0, float(np.nanpercentile(deviation, 95))),
        title="Stated deviation of depth",
    )  # fmt: skip
    figure.colorbar(shown, ax=left, label="cm", shrink=0.85)
    flagged = (image["quality"].values != 0).astype(float)
    show_plane(middle, flagged, aspect=aspect, limits=(0, 1), title="Pixels with a flag")
    ratio = (image["depth"].values - truth.depth) / image["depth_std"].values
    plain = ratio[(flagged == 0) & np.isfinite(ratio)]
    ends = np.linspace(-4, 4, 41)
    right.hist(np.clip(plain, -4, 4), bins=ends, density=True, color=JOINT["color"], alpha=0.5)
    right.plot(ends, np.exp(-(ends**2) / 2) / np.sqrt(2 * np.pi), label="normal", **TRUTH)
    right.set_title(f"{(np.abs(plain) < 1).mean():.0%} lie within their deviation")
    label_lines(right, "error / stated deviation, no flag", "density")
    return figure


def distances(findings: Findings) -> Figure:
    """Fig. 7: depth of a wall and a board at 0.5, 1.0 and 1.5 m by both methods."""
    aspect = pixel_aspect(findings.instrument)
    captures = findings.distances
    figure, axes = panels(3, len(captures), width=11, height=7)
    row = scaled_row(DISTANCES_ROW, findings.instrument)
    for column, (distance, capture) in enumerate(captures.items()):
        low, high = _depth_limits(capture)
        profile = axes[2, column]
        for place, name, image, look in (
            (axes[0, column], "paper", capture.image, PAPER),
            (axes[1, column], "joint", capture.joint, JOINT),
        ):
            depth = image["depth"].values
            shown = show_plane(
                place, depth, aspect=aspect, limits=(low, high), colours=DEPTH_MAP,
                title=f"scene at {distance} m, {name}",
            )  # fmt: skip
            figure.colorbar(shown, ax=place, shrink=0.8, label="depth / m")
            place.axhline(row, color="white", linewidth=0.7)
            profile.plot(depth[row], label=name, **look)
        profile.plot(capture.truth.depth[row], label="truth", **TRUTH)
        profile.set_ylim(low - 0.1, high + 0.2)
        profile.set_title(f"row {row}")
        label_lines(profile, "column", "depth / m", legend=column == 0)
    return figure


def frame_numbers(findings: Findings) -> Figure:
    """Fig. 8: reflectance at 445 nm from different numbers of frames, by both methods."""
    aspect = pixel_aspect(findings.instrument)
    band = int(np.argmin(np.abs(findings.instrument.wavelengths_nm - 445)))
    figure, axes = panels(2, len(findings.frame_series), width=11, height=4.8)
    for column, (frames, capture) in enumerate(findings.frame_series.items()):
        ours = capture.joint["reflectance"].values[:, :, band]
        top = float(np.nanpercentile(ours, 98)) if np.isfinite(ours).any() else 1.0
        pooled = "pooled" if frames < POOLED_BELOW_FRAMES else "joint"
        for place, name, image in (
            (axes[0, column], "paper", capture.image),
            (axes[1, column], pooled, capture.joint),
        ):
            plane = image["reflectance"].values[:, :, band]
            title = f"{frames} frames, {name}"
            show_plane(place, plane, aspect=aspect, limits=(0, top), title=title)
    return figure


def ranging(findings: Findings) -> Figure:
    """Fig. 9: measured distance of a plane with codes of 55 ps, and the residual."""
    series = findings.ranging
    figure, (upper, lower) = panels(2, 1, width=7.5, height=4.4, sharex=True, height_ratios=[2, 1])
    lower[0].fill_between(
        series.truth, -100 * series.bound, 100 * series.bound, color="0.88", linewidth=0
    )
    lower[0].axhline(0, **TRUTH)
    for name, found, look, marker in (
        ("paper", series.measured, PAPER, "s"),
        ("joint", series.joint, JOINT, "o"),
    ):
        style = {"color": look["color"], "marker": marker, "linestyle": "", "markersize": 4}
        upper[0].plot(series.truth, found, label=name, **style)
        lower[0].plot(series.truth, 100 * (found - series.truth), **style)
    upper[0].plot(series.truth, series.truth, label="truth", **TRUTH)
    upper[0].set_ylabel("measured / m")
    upper[0].legend()
    upper[0].set_title(
        f"σ: paper {100 * series.deviation:.2f} cm, joint {100 * series.joint_deviation:.2f} cm; "
        "shaded: ± bound"
    )
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


def _draw_windows(
    axes: Axes, findings: Findings
) -> list[tuple[tuple[float, float], float, int, float]]:
    """Draw the counts of the example pixel and the windows of its bands.

    Returns the limits of each window in ns, its wavelength in nm, its counts, and the counts of the
    highest bin.
    """
    calibration = findings.calibration
    bins = calibration.bins
    row, col = example_pixel(findings)
    counts = bins.in_time_order(findings.main.histogram)[row, col]
    delay_ns = _delay_ns(findings, row, col)
    shift = round(float(calibration.pixel_delay[row, col]) + delay_ns / calibration.bin_width_ns)
    axes.step(bins.centers_ns, counts, where="mid", color="0.25", linewidth=0.8)
    top = float(counts.max())
    drawn = []
    for window in calibration.windows:
        nm = calibration.instrument.bands[window.band].wavelength_nm
        inside = np.arange(window.start, window.stop) + shift
        low_ns, high_ns = bins.edges_ns[np.clip([inside[0], inside[-1] + 1], 0, bins.count)]
        look = {"color": wavelength_colour(nm), "alpha": 0.18}
        axes.add_patch(Rectangle((low_ns, 0), high_ns - low_ns, 1.02 * top, **look))
        total = int(counts[inside % bins.count].sum())
        drawn.append(((float(low_ns), float(high_ns)), nm, total, top))
    axes.set_ylim(0, 1.04 * top)
    label_lines(axes, "arrival time / ns", "counts per bin", legend=False)
    return drawn


def _draw_spectra(axes: Axes, findings: Findings, region: str) -> None:
    """Draw the mean spectrum of a region by both methods, and its true spectrum."""
    capture, instrument = findings.main, findings.instrument
    inside = capture.truth.regions[region]
    order = np.argsort(instrument.wavelengths_nm)
    wavelengths = instrument.wavelengths_nm[order]
    for label, image, look in (("paper", capture.image, PAPER), ("joint", capture.joint, JOINT)):
        found = region_spectra(image, {region: inside}).sel(region=region)
        axes.errorbar(
            wavelengths, found["reflectance"].values[order],
            yerr=found["reflectance_std"].values[order],
            marker="o", markersize=3.5, capsize=2, label=label, **look,
        )  # fmt: skip
    truth = capture.truth.reflectance[:, inside].mean(axis=1)[order]
    axes.plot(wavelengths, truth, label="truth", **TRUTH)
    axes.set_ylim(bottom=0)


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
