# SPDX-License-Identifier: Apache-2.0
"""The commands `hueflight instrument new | check | show`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from cyclopts import App, Parameter

from hueflight.calibration.description_check import check_description
from hueflight.cli.choices import PRESETS
from hueflight.cli.exit_codes import FAILED
from hueflight.cli.options import WHOLE
from hueflight.cli.output import print_notice, show
from hueflight.cli.units import require_meters
from hueflight.errors import InstrumentError
from hueflight.files import import_optional, refuse_existing, staged
from hueflight.importers import tcspc_instrument
from hueflight.importers.captures import read_capture
from hueflight.importers.options import AXES
from hueflight.model.instrument import Band, Instrument, Lens, Sensor, Timing

instrument = App(
    name="instrument",
    help="Make the description of an instrument, compare it with a capture, or show it.",
    help_format="markdown",
)

NO_LENS = (
    "without a lens, depth is the distance along each pixel's ray and point clouds have no width; "
    "--focal-length (or --field-of-view) and --pixel-width state one"
)


@instrument.command
def new(
    out: Path,
    *,
    source: Annotated[Path | None, Parameter(name=["--from"])] = None,
    band: tuple[str, ...] = (),
    name: str | None = None,
    rows: Annotated[int | None, WHOLE] = None,
    cols: Annotated[int | None, WHOLE] = None,
    code_bits: Annotated[int | None, WHOLE] = None,
    bin_width: float | None = None,
    period: float | None = None,
    direction: Literal["forward", "reverse"] = "forward",
    code_zero: Literal["bin", "no photon"] = "bin",
    latency: float = 0.0,
    focal_length: float | None = None,
    field_of_view: float | None = None,
    pixel_width: float | None = None,
    pixel_height: float | None = None,
    dataset: str | None = None,
    channel: Annotated[int | None, WHOLE] = None,
    overwrite: bool = False,
) -> None:
    """Write the description of an instrument from a few answers.

    At a terminal, what is missing is asked for. In a script, everything is given as options.

    Parameters
    ----------
    out : Path
        File to write, NAME.toml.
    source : Path, optional
        A .ptu or .sdt file, whose pixels, time bins and period are taken.
    band : tuple of str
        Once for each LED or laser, in the order of the bands: NAME,WAVELENGTH,DELAY,WIDTH with the
        wavelength in nm, the time in the period at which it fires in ns, and the full width at half
        maximum of its pulse in ns, such as --band red,640,5,1.2.
    name : str, optional
        Name of the instrument; by default that of the file.
    rows : int, optional
        Number of rows of pixels.
    cols : int, optional
        Number of columns of pixels.
    code_bits : int, optional
        Bits of a code: a histogram has 2 to this power bins.
    bin_width : float, optional
        Width of a time bin, ns.
    period : float, optional
        Time after which the pulses repeat, ns. Left out for single shots.
    direction : {"forward", "reverse"}
        Whether later photons have larger codes (forward) or smaller ones (reverse).
    code_zero : {"bin", "no photon"}
        Whether code 0 is a time bin, or counts exposures without a photon.
    latency : float, default 0
        Arrival time of a pulse of delay 0 from distance 0, ns.
    focal_length : float, optional
        Focal length of the lens, mm.
    field_of_view : float, optional
        Horizontal field of view in degrees, in place of the focal length.
    pixel_width : float, optional
        Distance between neighbouring columns of pixels, µm.
    pixel_height : float, optional
        Distance between neighbouring rows, µm; by default the same.
    dataset : str, optional
        Number of the data block of an .sdt file; by default the only one with decays.
    channel : int, optional
        Detection channel of a .ptu or .sdt file, counted from 0.
    overwrite : bool, default False
        Replace an existing file.
    """
    refuse_existing(out, overwrite=overwrite)
    answers: dict[str, Any] = {
        "rows": rows, "cols": cols, "code_bits": code_bits, "bin_width_ns": bin_width,
    }  # fmt: skip
    if source is None:
        answers = _completed(answers)
        if period is None and _at_terminal():
            text = _ask("Period of the pulses in ns (empty for single shots)")
            period = _number("--period", text) if text else None
    bands = tuple(_band(text) for text in band or _asked_bands())
    if source is not None:
        made = tcspc_instrument(
            source, bands, name=name or out.stem, channel=channel, block=dataset
        )
        given = {key: value for key, value in answers.items() if value is not None}
        if given:
            raise InstrumentError(
                f"--from {source}: {', '.join(given)} come from the file; leave these options out"
            )
        sensor, timing = made.sensor, made.timing
        if period is not None or latency:
            timing = Timing(period_ns=period or timing.period_ns, latency_ns=latency)
    else:
        sensor = Sensor(**answers, direction=direction, code_zero=code_zero)
        timing = Timing(period_ns=period, latency_ns=latency)
    lens, pitch = _lens(sensor.cols, focal_length, field_of_view, pixel_width, pixel_height)
    described = Instrument(
        name=name or out.stem,
        description="" if source is None else f"from {source.name}",
        sensor=msgspec.structs.replace(sensor, **pitch),
        timing=timing,
        bands=bands,
        lens=lens,
    )
    with staged(out, overwrite=overwrite) as partial:
        partial.write_text(described.to_toml(), encoding="utf-8")
    if lens is None:
        print_notice(NO_LENS)
    show(f"Instrument {out}", described.facts(), json_wanted=False)


@instrument.command(name="show")
def show_instrument(
    source: Annotated[str, Parameter(help=f"A preset ({PRESETS}) or the path of a TOML file.")],
    *,
    toml: bool = False,
    json: bool = False,
) -> None:
    """Show an instrument on one screen.

    Parameters
    ----------
    source : str
        A preset or the path of a TOML file.
    toml : bool, default False
        Print the description as TOML, such as a preset to start from.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    loaded = Instrument.load(source)
    if toml:
        print(loaded.to_toml(), end="")
        return
    show(f"Instrument {loaded.name}", loaded.facts(), json_wanted=json)


@instrument.command
def check(
    description: str,
    reference: Path,
    *,
    distance: Annotated[float, Parameter(name=["--distance", "-d"])],
    picture: Annotated[Path | None, Parameter(name=["--picture", "-p"])] = None,
    dataset: str | None = None,
    axes: str = AXES,
    channel: Annotated[int | None, WHOLE] = None,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Compare the description of an instrument with a capture of a flat target.

    It shows whether a pulse stands where each band fires, how wide it is, and in which direction
    codes count. The exit code is 1 if something does not fit.

    Parameters
    ----------
    description : str
        A preset or the path of a TOML file.
    reference : Path
        Capture of the target with all LEDs on: a recording (.mcap) or counts.
    distance : float
        Distance of the target from the camera, in metres.
    picture : Path, optional
        Picture to draw, NAME.png: the capture and the described pulses.
    dataset : str, optional
        Name of the array in files that hold several arrays, or number of the data block in .sdt
        files.
    axes : str, default "row,col,code"
        Names of the axes of the array, in its order.
    channel : int, optional
        Detection channel of .ptu and .sdt files, counted from 0.
    overwrite : bool, default False
        Replace an existing picture.
    json : bool, default False
        Print one JSON object instead of a table.

    Returns
    -------
    int
        Exit code.
    """
    if picture is not None:
        refuse_existing(picture, overwrite=overwrite)
    loaded = Instrument.load(description)
    require_meters(distance, loaded)
    capture = read_capture(reference, loaded, dataset=dataset, axes=axes, channel=channel)
    found = check_description(capture.counts, loaded, distance=distance)
    if picture is not None:
        import_optional("matplotlib", extra="report")
        from hueflight.report.description import draw_description_check

        with staged(picture, overwrite=overwrite) as partial:
            draw_description_check(found, loaded).savefig(partial, format="png")
    facts: dict[str, Any] = {
        "fits": not found.problems,
        "direction": found.direction,
        "latency_ns": round(found.latency_ns, 3),
    }
    for pulse in found.pulses:
        facts[f"band {pulse.band}" if not json else pulse.band] = (
            f"found at {pulse.found_ns:.2f} ns, due at {pulse.due_ns:.2f} ns; "
            f"{pulse.found_fwhm_ns:.2f} ns wide, described {pulse.due_fwhm_ns:.2f} ns; "
            f"{pulse.share:.0%} of the light"
        )
    if json:
        facts["problems"] = list(found.problems)
    else:
        facts |= {f"problem {number}": text for number, text in enumerate(found.problems, 1)}
    show(f"Instrument {description} beside {reference}", facts, json_wanted=json)
    return FAILED if found.problems else 0


def _at_terminal() -> bool:
    return sys.stdin.isatty() and sys.stderr.isatty()


def _ask(question: str) -> str:
    print(f"{question}: ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip()


QUESTIONS = {
    "rows": "Rows of pixels",
    "cols": "Columns of pixels",
    "code_bits": "Bits of a code (a histogram has 2 to this power bins)",
    "bin_width_ns": "Width of a time bin in ns",
}


def _completed(answers: dict[str, Any]) -> dict[str, Any]:
    """Ask for what is missing, at a terminal."""
    missing = [field for field, value in answers.items() if value is None]
    options = ", ".join("--" + field.removesuffix("_ns").replace("_", "-") for field in missing)
    if missing and not _at_terminal():
        raise InstrumentError(f"{options} missing: give them, or --from FILE.ptu or FILE.sdt")
    for field in missing:
        number = _number(field, _ask(QUESTIONS[field]))
        answers[field] = number if field == "bin_width_ns" else round(number)
    return answers


def _asked_bands() -> list[str]:
    if not _at_terminal():
        raise InstrumentError(
            "--band missing: give one for each LED or laser, NAME,WAVELENGTH,DELAY,WIDTH, such as "
            "--band red,640,5,1.2"
        )
    bands: list[str] = []
    while text := _ask(
        f"Band {len(bands) + 1} as NAME,WAVELENGTH_NM,DELAY_NS,WIDTH_NS (empty to end)"
    ):
        bands.append(text)
    return bands


def _number(option: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InstrumentError(f"{option} {text!r}: a number is needed") from None


def _band(text: str) -> Band:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 4:
        raise InstrumentError(
            f"--band {text}: give NAME,WAVELENGTH,DELAY,WIDTH in nm and ns, such as red,640,5,1.2"
        )
    numbers = [_number(f"--band {text}:", part) for part in parts[1:]]
    return Band(
        name=parts[0], wavelength_nm=numbers[0], delay_ns=numbers[1], pulse_fwhm_ns=numbers[2]
    )


def _lens(
    cols: int,
    focal_length: float | None,
    field_of_view: float | None,
    pixel_width: float | None,
    pixel_height: float | None,
) -> tuple[Lens | None, dict[str, float]]:
    """The lens, and the pitch of the pixels as entries of the sensor."""
    pitch: dict[str, float] = {}
    if pixel_width is not None:
        pitch = {"pixel_width_um": pixel_width, "pixel_height_um": pixel_height or pixel_width}
    if focal_length is None and field_of_view is None:
        return None, pitch
    if pixel_width is None:
        raise InstrumentError(
            "--focal-length and --field-of-view need --pixel-width, the distance between "
            "neighbouring columns in µm (the active width divided by the number of columns)"
        )
    if focal_length is not None and field_of_view is not None:
        raise InstrumentError("--focal-length and --field-of-view: give one of them")
    if focal_length is None and field_of_view is not None:
        if not 0 < field_of_view < 180:
            raise InstrumentError(f"--field-of-view {field_of_view:g}: between 0 and 180 degrees")
        focal_length = 1e-3 * pixel_width * cols / (2 * np.tan(np.radians(field_of_view) / 2))
    assert focal_length is not None  # one of the two is given
    return Lens(focal_length_mm=round(float(focal_length), 6)), pitch
