# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hueflight.cli.options import WHOLE
from hueflight.cli.output import progress, show
from hueflight.errors import HueflightError
from hueflight.files import refuse_existing

if TYPE_CHECKING:
    from hueflight.report.experiments import Findings

LEAST_FRAMES = 100
PAGE, NUMBERS, PIXELS = "index.html", "figures.json", "pixels.html"


def demo(
    *,
    out: Path = Path("out/demo"),
    frames: Annotated[int, WHOLE] = 10_000,
    seed: Annotated[int, WHOLE] = 1,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Redraw the published figures from a simulated instrument, as a page with pictures.

    Parameters
    ----------
    out : Path, optional
        Folder for the page (index.html), its pictures, its numbers (figures.json) and a page on
        which every pixel can be looked at (pixels.html). A report that is there already is
        replaced.
    frames : int, default 10000
        Number of frames in each capture, at least 100. The published captures had 10000.
    seed : int, default 1
        Seed of the random numbers that draw the photons and the sensor's defects.
    overwrite : bool, default False
        Replace a page of that name that this command did not write.
    json : bool, default False
        Print the report's numbers as one JSON object instead of a table.
    """
    if frames < LEAST_FRAMES:
        raise HueflightError(
            f"--frames {frames}: the report needs at least {LEAST_FRAMES} frames per capture"
        )
    if not (out / NUMBERS).exists():  # an earlier report is replaced
        refuse_existing(out / PAGE, overwrite=overwrite)
    try:
        from hueflight.report import FurtherPage, make_report
    except ImportError as error:
        raise HueflightError(
            f"the report needs {error.name}, which is not installed: "
            "pip install 'hueflight[report]'"
        ) from None
    numbers = make_report(
        out,
        frames=frames,
        seed=seed,
        progress=progress(json_wanted=json),
        pages={PIXELS: FurtherPage("Look at any pixel of Fig. 1", _pixels)},
    )
    show(f"Report: {out / PAGE}", numbers, json_wanted=json)


def _pixels(findings: Findings) -> str:
    """Page on which each pixel of the scene of Fig. 1 can be looked at."""
    from hueflight.daemon.viewer import viewer_page

    return viewer_page(
        title="The scene of Fig. 1, by the joint fit",
        instrument=findings.instrument,
        image=findings.main.joint,
        histogram=findings.main.histogram,
        calibration=findings.calibration,
    )
