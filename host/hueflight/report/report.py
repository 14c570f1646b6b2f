# SPDX-License-Identifier: Apache-2.0
"""The report itself: a self-contained HTML page and its figures."""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.figure import Figure

from hueflight.files import make_parent, replace_file
from hueflight.model.instrument import Instrument
from hueflight.progress import Progress, Silent, tracked
from hueflight.report import figures
from hueflight.report.accuracy import accuracy
from hueflight.report.experiments import FEW_FRAMES, RANGE_PHOTONS, Findings, run_all
from hueflight.report.page import picture_section, png, style_sheet


@dataclass(frozen=True)
class Section:
    """A section of the page, with one figure.

    Attributes
    ----------
    name : str
        Name of the picture file without extension, and anchor in the page.
    heading : str
        Heading, with the number of the paper's figure.
    text : str
        What the figure shows.
    draw : callable
        Function that draws the figure from the findings.
    """

    name: str
    heading: str
    text: str
    draw: Callable[[Findings], Figure]


@dataclass(frozen=True)
class FurtherPage:
    """A page beside the report, to which it links.

    Attributes
    ----------
    words : str
        What one sees there: the text of the link.
    make : callable
        Function that makes the page from the findings.
    """

    words: str
    make: Callable[[Findings], str]


SECTIONS = (
    Section(
        "glance", "At a glance",
        "LEDs of nine colors flash one after another, and each pixel counts when their photons "
        "come back. These counts tell its depth and its color. A hundred frames are too few for "
        "the published method; Hueflight shares photons between neighbors that see the same "
        "surface. Pixels of which nothing is known are pink.",
        figures.at_a_glance,
    ),
    Section(
        "scene", "Fig. 1 · The scene",
        "A board with coloured logos, a brick wall with a window 20 cm in front of it, and a horse "
        "another 10 cm in front of the wall. Surfaces that the sensor sees but that not every LED "
        "reaches are in shadow.",
        figures.scene_truth,
    ),
    Section(
        "histograms", "Fig. 2 · Histograms and cross-correlation",
        "Arrival times at one pixel: nine pulses, one for each LED. Light from the scene arrives "
        "later than from the reference at 0.40 m; the centroid of the middle peak of the "
        "correlation gives the delay.",
        figures.histograms_and_correlation,
    ),
    Section(
        "windows", "Fig. 3 · Band windows",
        "The reference determines which bins belong to which LED. Shifted by the delay of each "
        "pixel, these windows give the counts of each band (eq. 2).",
        figures.band_windows,
    ),
    Section(
        "reflectance", "Fig. 4 · Reflectance in nine bands",
        "Reflectance relative to a white sheet, by the paper's method (above) and the joint fit "
        "(below), in the same colors. Hot and dead pixels are left out (pink); only the RGB "
        "picture fills them with values from their neighbors.",
        figures.reflectance_images,
    ),
    Section(
        "spectra", "Fig. 5 · Spectra of regions",
        "Mean over each region with its standard error, and the simulated truth. The paper's "
        "equation (2) subtracts neither the background nor the tails of neighboring pulses. Dark "
        "bands therefore appear too bright, most of all that of the weak amber LED. The joint fit "
        "estimates both together with depth and reflectance.",
        figures.spectra_of_regions,
    ),
    Section(
        "depth", "Fig. 6 · Depth",
        "Depth along the optical axis by both methods, and two rows of it with the truth. Few "
        "photons return from shadows (ticks), where depth is uncertain or missing.",
        figures.depth_and_profiles,
    ),
    Section(
        "uncertainty", "What the joint fit says about itself",
        "Each pixel states its deviation; pixels that are defective, see no surface, too little "
        "light, or counts that one surface does not explain have a flag. The errors of the others, "
        "divided by their stated deviations, are compared with a normal distribution.",
        figures.uncertainty_and_flags,
    ),
    Section(
        "distances", "Fig. 7 · Other distances",
        "A brick wall 20 cm in front of a board, with the middle between them at 0.5, 1.0 and "
        "1.5 m.",
        figures.distances,
    ),
    Section(
        "frames", "Fig. 8 · Fewer frames",
        "Reflectance in the 445 nm band from 10, 100, 1000 and all frames, in the same colors "
        "for both methods. Up to 1000 frames the pooled method shares photons between neighbors "
        "that see the same surface.",
        figures.frame_numbers,
    ),
    Section(
        "ranging", "Fig. 9 · Finer codes",
        "A single fast detector with codes of 55 ps in front of a plane at increasing distances.",
        figures.ranging,
    ),
)  # fmt: skip


def make_report(
    out: Path,
    *,
    instrument: Instrument | None = None,
    frames: int = 10_000,
    seed: int = 1,
    progress: Progress | None = None,
    pages: Mapping[str, FurtherPage] | None = None,
) -> dict[str, float]:
    """Repeat the paper's experiments with the simulated instrument and write a report.

    The report consists of `index.html` (self-contained), one PNG file per figure, and
    `figures.json` with the numbers of the table.

    Parameters
    ----------
    out : Path
        Folder for the report; it is created if it does not exist.
    instrument : Instrument or None
        Instrument to simulate; None for the preset `paper`.
    frames : int
        Number of exposures of the main captures and of the calibration.
    seed : int
        Seed of the imperfections and of the photon noise.
    progress : Progress or None
        Display of the progress; None for none.
    pages : mapping of str to FurtherPage, optional
        Further pages by file name.

    Returns
    -------
    dict of str to float
        Numbers of the table by name; the end of a name gives the unit.
    """
    shown = progress or Silent()
    findings = run_all(
        instrument or Instrument.load("paper"), frames=frames, seed=seed, progress=shown
    )
    make_parent(out / "index.html")
    pictures: dict[str, bytes] = {}
    for section in tracked(SECTIONS, shown, "pictures", len(SECTIONS)):
        pictures[section.name] = png(section.draw(findings))
        replace_file(out / f"{section.name}.png", pictures[section.name])
    numbers = key_numbers(findings)
    replace_file(out / "figures.json", json.dumps(numbers, indent=2) + "\n")
    further = pages or {}
    for name, page in further.items():
        replace_file(out / name, page.make(findings))
    links = {name: page.words for name, page in further.items()}
    replace_file(out / "index.html", _page(findings, numbers, pictures, links))
    return numbers


def key_numbers(findings: Findings) -> dict[str, float]:
    """Numbers that the table of the report compares with the paper, by name."""
    row, joint = findings.background_row, findings.joint_row
    ranging, wire = findings.ranging, findings.wire
    few = findings.frame_series[FEW_FRAMES]
    paper, joint_fit = (accuracy(findings.main, image) for image in findings.main.images)
    few_paper, few_pooled = (accuracy(few, image) for image in few.images)
    return {
        "frames": findings.main.frames,
        "background_row_deviation_cm": 100 * row.deviation,
        "background_row_bias_cm": 100 * row.bias,
        "background_row_joint_deviation_cm": 100 * joint.deviation,
        "background_row_joint_bias_cm": 100 * joint.bias,
        "background_row_bound_cm": 100 * row.bound,
        "background_row_photons": row.photons,
        "ranging_deviation_cm": 100 * ranging.deviation,
        "ranging_joint_deviation_cm": 100 * ranging.joint_deviation,
        "ranging_bound_cm": 100 * float(np.mean(ranging.bound)),
        "reflectance_error_percent": 100 * paper.reflectance,
        "reflectance_joint_error_percent": 100 * joint_fit.reflectance,
        "few_frames_error_cm": 100 * few_paper.depth,
        "few_frames_pooled_error_cm": 100 * few_pooled.depth,
        "few_frames_known_percent": 100 * few_paper.known,
        "few_frames_pooled_known_percent": 100 * few_pooled.known,
        "within_deviation_percent": 100 * paper.within,
        "within_joint_deviation_percent": 100 * joint_fit.within,
        "wire_frames": wire.frames,
        "wire_identical": float(wire.identical),
        "wire_bytes_per_frame": wire.bytes_per_frame,
        "wire_photons": wire.photons,
        "occupancy": wire.photons / wire.frames / np.prod(findings.instrument.image_shape),
    }


def _page(
    findings: Findings,
    numbers: dict[str, float],
    pictures: dict[str, bytes],
    links: dict[str, str],
) -> str:
    """Whole HTML page, with the pictures embedded."""
    template = (resources.files("hueflight.report") / "page.html").read_text("utf-8")
    sections = "\n".join(
        picture_section(s.name, s.heading, s.text, pictures[s.name]) for s in SECTIONS
    )
    wire = findings.wire
    return Template(template).substitute(
        style=style_sheet(),
        version=version("hueflight"),
        frames=findings.main.frames,
        table=_table(numbers),
        links="".join(
            f'<a class="onward" href="{html.escape(name)}">{html.escape(words)}</a>'
            for name, words in links.items()
        ),
        wire_words=(
            f"{wire.frames} frames were drawn exposure by exposure, encoded as packets "
            f"({wire.bytes_per_frame:,.0f} bytes each at occupancy {numbers['occupancy']:.2f}), "
            f"and decoded again: {wire.photons:,} photons. "
            + ("All counts are equal." if wire.identical else "The counts DIFFER.")
        ),
        sections=sections,
    )


def _table(numbers: dict[str, float]) -> str:
    """Rows of the HTML table that compares the numbers with the paper's."""
    few = f"{FEW_FRAMES} frames"
    rows = [
        (
            "Depth, background row 139",
            "3.41 cm",
            *_with_bound(
                numbers["background_row_deviation_cm"],
                numbers["background_row_joint_deviation_cm"],
                numbers["background_row_bound_cm"],
            ),
            f"Standard deviation over the row at {numbers['frames']:,.0f} frames, "
            f"{numbers['background_row_photons']:,.0f} signal photons per pixel. The paper's "
            "value corresponds to about 300 photons; it does not state how many arrived. The "
            "bound leaves out the noise of the reference.",
        ),
        (
            "Range, single pixel, 55 ps",
            "0.64 cm",
            *_with_bound(
                numbers["ranging_deviation_cm"],
                numbers["ranging_joint_deviation_cm"],
                numbers["ranging_bound_cm"],
            ),
            "Standard deviation of the residual over distances from 0.1 to 2.5 m, about "
            f"{RANGE_PHOTONS:,} photons each. The paper does not state the number of photons.",
        ),
        (
            "Reflectance, nine bands",
            "–",
            f"{numbers['reflectance_error_percent']:.1f} %",
            f"{numbers['reflectance_joint_error_percent']:.1f} %",
            "–",
            "Root mean square error over all bands of the pixels that light reaches, in percent of "
            "white. The paper shows spectra but states no error.",
        ),
        (
            f"Depth from {few}",
            "–",
            f"{numbers['few_frames_error_cm']:.1f} cm",
            f"{numbers['few_frames_pooled_error_cm']:.1f} cm",
            "–",
            "Median error of the pixels that light reaches; pooled over neighbors (second). "
            f"{numbers['few_frames_known_percent']:.0f} % and "
            f"{numbers['few_frames_pooled_known_percent']:.0f} % of them have a depth.",
        ),
        (
            "Depths within their stated deviation",
            "–",
            f"{numbers['within_deviation_percent']:.0f} %",
            f"{numbers['within_joint_deviation_percent']:.0f} %",
            "68 %",
            "Pixels that light reaches and that have no flag. The paper states no deviations.",
        ),
    ]
    return "\n".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )


def _with_bound(published_method: float, joint: float, bound: float) -> tuple[str, str, str]:
    """Cells of two deviations with their ratios to the bound, and of the bound."""
    return (
        f"{published_method:.2f} cm ({published_method / bound:.2f} ×)",
        f"{joint:.2f} cm ({joint / bound:.2f} ×)",
        f"{bound:.2f} cm",
    )
