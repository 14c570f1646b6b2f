"""hueflight demo"""

from __future__ import annotations

from pathlib import Path

from hueflight.cli.app import app
from hueflight.cli.output import progress, show
from hueflight.errors import HueflightError


@app.command
def demo(
    *, out: Path = Path("out/demo"), frames: int = 10_000, seed: int = 1, json: bool = False
) -> None:
    """Redraw the published figures from a simulated instrument: a page with pictures.

    Parameters
    ----------
    out
        Folder for `index.html`, the pictures and `figures.json`.
    frames
        Frames per capture; 10 000 as published.
    seed
        Draws the photons and the sensor's defects.
    json
        Print the numbers as JSON.
    """
    if frames < 100:
        raise HueflightError(f"--frames {frames}: the report needs at least 100 frames per capture")
    try:
        from hueflight.report import make_report
    except ImportError as error:
        raise HueflightError(
            f"the report needs {error.name}, which is not installed: "
            "pip install 'hueflight[report]'"
        ) from None
    numbers = make_report(out, frames=frames, seed=seed, progress=progress(json_wanted=json))
    show(f"Report: {out / 'index.html'}", numbers, json_wanted=json)
