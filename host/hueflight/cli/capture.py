# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight capture`."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from hueflight.acquisition.plan import CaptureError, RunPlan
from hueflight.acquisition.precision_stop import PrecisionStop
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.snapshot import Snapshot
from hueflight.acquisition.summary import write_summary
from hueflight.acquisition.sums_reduction import reduction_of
from hueflight.calibration import Calibration
from hueflight.cli.choices import PRESETS, SCENE_NAMES
from hueflight.cli.options import WHOLE
from hueflight.cli.output import error_console, print_notice, show
from hueflight.devices.built_in_rigs import choose_rig
from hueflight.devices.camera_controls import CameraControls
from hueflight.devices.illumination import GUIDANCE, CaptureKind
from hueflight.devices.reduction import Reduction
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.stopping import StopRule
from hueflight_protocol import ReductionRoom

CONNECT_S = 10.0
PICTURES_HZ = 10.0  #: of sums
REFRESH_S = 0.2


def capture(
    kind: CaptureKind = "scene",
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    instrument: Annotated[
        str, Parameter(help=f"Instrument: a preset ({PRESETS}) or the path of a TOML file.")
    ] = "paper",
    frames: Annotated[int, WHOLE] = 0,
    seconds: float | None = None,
    photons: float | None = None,
    calibration: Path | None = None,
    until_depth_std: float | None = None,
    until_reflectance_std: float | None = None,
    share: float = 0.9,
    reduce: Annotated[bool, Parameter(negative=())] = False,
    picture_frames: Annotated[int | None, WHOLE] = None,
    distance: float | None = None,
    note: str = "",
    rig: str | None = None,
    camera: str | None = None,
    illuminator: str | None = None,
    simulate: bool | None = None,
    scene: Annotated[
        str, Parameter(help=f"Scene of the simulated instrument: {SCENE_NAMES}.")
    ] = "fig1",
    yes: bool = False,
    json: bool = False,
) -> None:
    """Record a capture from the camera.

    The capture ends at the first limit that is reached, or at Ctrl-C; the recording is complete
    either way. Frames that are lost are counted, and the result says where they were lost.

    Parameters
    ----------
    kind : str, default "scene"
        What to capture: the scene, or one of the captures that a calibration is made from
        (reference, bands for one LED at a time, dark, flat).
    out : Path
        Recording to write, NAME.mcap. A summary of the capture is written to NAME.json.
    instrument : str, default "paper"
        Instrument: a preset or the path of a TOML file.
    frames : int, default 0
        Number of frames after which the capture ends (for a capture of kind bands: for each LED).
        With 0, the number of frames is not limited.
    seconds : float, optional
        Duration after which the capture ends, in seconds. By default it is not limited.
    photons : float, optional
        Mean number of photons per pixel after which the capture ends. By default it is not
        limited.
    calibration : Path, optional
        Calibration NAME.zarr with which the uncertainties of pixels are estimated or the tables of
        sums are designed; needed for --until-depth-std, --until-reflectance-std and --reduce.
    until_depth_std : float, optional
        Standard deviation of depth, in metres, at which the capture ends. By default depth does
        not end it.
    until_reflectance_std : float, optional
        Standard deviation of reflectance, in every band, at which the capture ends. By default
        reflectance does not end it.
    share : float, default 0.9
        Fraction of pixels that must reach the target of --until-depth-std or
        --until-reflectance-std.
    reduce : bool, default False
        Have the camera send a few sums per pixel instead of all codes, for links that do not carry
        these. Images of such a recording are made with method sums.
    picture_frames : int, optional
        Frames behind each picture of sums. By default those of a tenth of a second.
    distance : float, optional
        Distance of the target from the camera, in metres, to be stored in the recording. By
        default none is stored.
    note : str, optional
        Text to be stored in the recording.
    rig : str, optional
        Address of the rig, such as usb:, simulated:fig1 or usb:0123ABCD+serial:/dev/ttyUSB0. It
        is given in place of --simulate, --scene, --camera and --illuminator.
    camera : str, optional
        Serial number of the camera. Needed only if several cameras are plugged in.
    illuminator : str, optional
        Serial port of the illuminator, such as /dev/ttyUSB0. Without it, something else has to
        drive the LEDs.
    simulate : bool, optional
        Use the simulated instrument, or never use it. By default it is used if no camera is
        plugged in.
    scene : str, default "fig1"
        Scene of the simulated instrument.
    yes : bool, default False
        Start at once, without asking whether camera and target are in place.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    if out.suffix.lower() != ".mcap":
        raise CaptureError(f"{out}: the name of a recording must end in .mcap")
    for written in (out, out.with_suffix(".json")):
        if written.exists():  # photons can't be had again: a capture never overwrites
            raise CaptureError(
                f"{str(written)!r} exists already: choose another name (a capture never replaces "
                "a file)"
            )
    described = Instrument.load(instrument)
    metadata = {"note": note} if note else {}
    known = calibration_for_sums(described, calibration) if reduce else None
    if picture_frames is not None and not reduce:
        raise CaptureError(f"--picture-frames {picture_frames}: it belongs to --reduce")
    if reduce and kind != "scene":
        raise CaptureError(f"--reduce: a capture of kind {kind!r} needs histograms, leave it out")
    targets = until_depth_std, until_reflectance_std
    if reduce and targets != (None, None):
        raise CaptureError(
            "--until-depth-std and --until-reflectance-std need histograms: leave out --reduce, or "
            "give --frames, --seconds or --photons"
        )
    if distance is not None:
        metadata["distance_m"] = str(distance)
    plan = RunPlan(
        kind=kind, frames=frames, seconds=seconds, photons_per_pixel=photons, path=out,
        metadata=metadata,
        precision_stop=None if reduce else until_of(described, calibration, *targets, share),
    )  # fmt: skip
    plan.check()
    connect = choose_rig(
        described, uri=rig, simulate=simulate, serial=camera, illuminator=illuminator, scene=scene,
        say=lambda text: print_notice(text, style="bold yellow"),
    )  # fmt: skip
    acquisition = Acquisition(connect, described)
    console = error_console()
    with _StopOnInterrupt(acquisition):
        try:
            _wait_for_rig(acquisition)
            if known is not None:  # tables must fit what the camera has room for
                room = acquisition.snapshot.reduction_room
                reduction = reduction_for(known, picture_frames, room)
                acquisition.set_controls(CameraControls(reduction=reduction), acquisition.settings)
            if console.is_terminal and not yes and not acquisition.snapshot.simulated:
                console.print(GUIDANCE[kind])
                console.input("Press Enter to begin. ")
            future = acquisition.run(plan)
            if console.is_terminal:
                _show_progress(console, acquisition, plan, future)
            result = future.result()
        finally:
            acquisition.close()
    summary = write_summary(out, result)
    show(f"Capture {out}", summary, json_wanted=json)
    if result.failure:
        raise HueflightError(f"the capture broke off: {result.failure}")


def calibration_for_sums(instrument: Instrument, calibration: Path | None) -> Calibration:
    """Load the calibration that sums are designed from.

    Parameters
    ----------
    instrument : Instrument
        Instrument of the capture.
    calibration : Path or None
        Calibration of the same instrument.

    Returns
    -------
    Calibration
        The calibration.

    Raises
    ------
    HueflightError
        If there is no calibration of this instrument.
    """
    if calibration is None:
        raise CaptureError("--reduce needs a calibration to design sums with: give --calibration")
    known = Calibration.load(calibration)
    known.require(instrument)
    return known


def reduction_for(
    calibration: Calibration, picture_frames: int | None, room: ReductionRoom | None
) -> Reduction:
    """What the camera needs for sums.

    Parameters
    ----------
    calibration : Calibration
        Calibration that they are designed from.
    picture_frames : int or None
        Frames of a picture.
    room : ReductionRoom or None
        What the camera has room for; None if it has none, and then refuses them.

    Returns
    -------
    Reduction
        Tables, offsets and frames of a picture.
    """
    rate_hz = calibration.instrument.sensor.usual_frame_rate_hz
    frames = picture_frames or max(1, round(rate_hz / PICTURES_HZ))
    return reduction_of(calibration, picture_frames=frames, room=room, rate_hz=rate_hz)


def until_of(
    instrument: Instrument,
    calibration: Path | None,
    depth_std: float | None,
    reflectance_std: float | None,
    share: float,
) -> PrecisionStop | None:
    """Precision at which a capture ends.

    Parameters
    ----------
    instrument : Instrument
        Instrument of the capture.
    calibration : Path or None
        Calibration of the same instrument.
    depth_std : float or None
        Standard deviation of depth to be reached, m.
    reflectance_std : float or None
        Standard deviation of reflectance to be reached in every band.
    share : float
        Fraction of pixels that must reach both.

    Returns
    -------
    PrecisionStop or None
        None if no precision is asked for.

    Raises
    ------
    HueflightError
        If a target can't be met, or the calibration is missing, or it is given without a target.
    """
    if depth_std is None and reflectance_std is None:
        if calibration is not None:
            raise CaptureError(
                f"calibration {calibration}: it serves no purpose without --until-depth-std (in "
                "metres) or --until-reflectance-std; give one of them or leave it out"
            )
        return None
    rule = StopRule(depth_std=depth_std, reflectance_std=reflectance_std, share=share)
    if calibration is None:
        raise CaptureError(
            "--until-depth-std and --until-reflectance-std need a calibration to estimate "
            "uncertainties with: give --calibration NAME.zarr"
        )
    known = Calibration.load(calibration)
    known.require(instrument)
    return PrecisionStop(rule, known)


class _StopOnInterrupt:
    """Ctrl-C ends the run, and with it the program, cleanly; a second one interrupts it."""

    def __init__(self, acquisition: Acquisition) -> None:
        self._acquisition = acquisition
        self._before: Any = None

    def __enter__(self) -> None:
        self._before = signal.signal(signal.SIGINT, self._pressed)

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _pressed(self, _number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, self._before)
        if self._acquisition.snapshot.recording:
            self._acquisition.stop()
        else:
            raise KeyboardInterrupt


def _wait_for_rig(acquisition: Acquisition) -> None:
    deadline = time.monotonic() + CONNECT_S
    while acquisition.snapshot.state == "disconnected":
        if time.monotonic() > deadline:
            raise CaptureError(acquisition.snapshot.problem)
        time.sleep(REFRESH_S)


def _show_progress(console: Console, acquisition: Acquisition, plan: RunPlan, future: Any) -> None:
    with Live(console=console, transient=True) as live:
        while not future.done():
            live.update(_progress(acquisition.snapshot, plan))
            time.sleep(REFRESH_S)


def _progress(snapshot: Snapshot, plan: RunPlan) -> Table:
    """Table of what was recorded and lost so far."""
    lost = {place: n for place, n in snapshot.totals.losses.as_dict().items() if n}
    goal = f" of {snapshot.run_limit:,}" if snapshot.run_limit else ""
    table = Table(show_header=False, box=None)
    table.add_column(style="cyan")
    table.add_column()
    for name, value in (
        ("state", snapshot.problem or f"{snapshot.state}: {plan.kind}"),
        ("frames", f"{snapshot.run_frames:,}{goal}"),
        ("photons", f"{snapshot.run_photons:,}"),
        ("lost", ", ".join(f"{n:,} at {place}" for place, n in lost.items()) or "none"),
        ("on disk", f"{snapshot.recorded_bytes / 1e6:,.1f} MB"),
        ("waiting for disk", f"{snapshot.recorder_queue_bytes / 1e6:,.1f} MB"),
    ):
        table.add_row(name, Text(value))
    return table
