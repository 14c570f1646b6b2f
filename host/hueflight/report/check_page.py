# SPDX-License-Identifier: Apache-2.0
"""The page that shows how an instrument has changed since its calibration."""

from __future__ import annotations

import html
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.figure import Figure

from hueflight.calibration import Calibration, CalibrationCheck
from hueflight.files import make_parent, replace_file
from hueflight.report.page import picture_section, png, style_sheet
from hueflight.report.style import MEASURED, panels, pixel_aspect, show_plane

Z_LIMIT = 6.0  #: standard deviations at the ends of the color map


def write_check_page(check: CalibrationCheck, calibration: Calibration, path: Path) -> None:
    """Write a self-contained HTML page with numbers and pictures of a check.

    Parameters
    ----------
    check : CalibrationCheck
        The check.
    calibration : Calibration
        Calibration that was checked.
    path : Path
        Name of the page; an existing one is replaced.

    Raises
    ------
    OutputError
        If the page can't be written.
    """
    template = (resources.files("hueflight.report") / "check.html").read_text("utf-8")
    sections = [
        (
            "bands", "Bands", "Change of each band with its standard deviation.",
            _bands(check, calibration),
        ),
        (
            "pixels", "Pixels",
            "Change of each pixel's delay and brightness, in standard deviations. Dead and hot "
            "pixels are pink; new ones are marked with a cross.",
            _pixels(check, calibration),
        ),
    ]  # fmt: skip
    findings = "".join(f"<li>{html.escape(text)}</li>" for text in check.findings)
    page = Template(template).substitute(
        style=style_sheet(),
        verdict="The calibration holds" if check.holds else "The calibration no longer holds",
        lead=html.escape(
            f"Instrument {calibration.instrument.name}, calibrated "
            f"{calibration.provenance.get('created', 'at an unknown time')} at "
            f"{calibration.distance:g} m."
        ),
        findings=f"<ul>{findings}</ul>" if findings else "",
        table=_rows(check),
        sections="\n".join(
            picture_section(name, heading, text, png(figure))
            for name, heading, text, figure in sections
        ),
        version=version("hueflight"),
    )
    make_parent(path)
    replace_file(path, page)


def _rows(check: CalibrationCheck) -> str:
    rows = []
    for k, name in enumerate(check.bands):
        cells = (
            name,
            f"{1000 * check.delay_ns[k]:+.0f} ± {1000 * check.delay_std_ns[k]:.0f}",
            f"{check.brightness[k]:.3f} ± {check.brightness_std[k]:.3f}",
            f"{check.width[k]:.3f} ± {check.width_std[k]:.3f}",
        )
        rows.append("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>")
    return "\n".join(rows)


def _bands(check: CalibrationCheck, calibration: Calibration) -> Figure:
    figure, (axes,) = panels(1, 3, width=10, height=3)
    place = calibration.instrument.wavelengths_nm
    shown = (
        ("delay beside all bands / ps", 1000 * check.delay_ns, 1000 * check.delay_std_ns, 0.0),
        ("brightness", check.brightness, check.brightness_std, 1.0),
        ("pulse width", check.width, check.width_std, 1.0),
    )
    for ax, (title, value, std, unchanged) in zip(axes, shown, strict=True):
        ax.axhline(unchanged, color="0.7", linewidth=0.8)
        ax.errorbar(place, value, yerr=std, fmt="o", markersize=4, color=MEASURED["color"])
        ax.set_title(title)
        ax.set_xlabel("wavelength / nm")
    return figure


def _pixels(check: CalibrationCheck, calibration: Calibration) -> Figure:
    figure, (axes,) = panels(1, 2, width=10, height=3.4)
    aspect = pixel_aspect(calibration.instrument)
    rows, cols = np.nonzero(check.new_dead | check.new_hot)
    shown = (("delay", check.pixel_z), ("brightness", check.brightness_z))
    for ax, (title, z) in zip(axes, shown, strict=True):
        drawn = show_plane(
            ax, z, aspect=aspect, title=title, limits=(-Z_LIMIT, Z_LIMIT), colours="RdBu_r"
        )
        ax.plot(cols, rows, "x", color="black", markersize=5)
        figure.colorbar(drawn, ax=ax, label="standard deviations", shrink=0.85)
    return figure
