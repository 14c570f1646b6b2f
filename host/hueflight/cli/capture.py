"""hueflight capture"""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.live import Live
from rich.table import Table

from hueflight.acquisition.plan import CaptureError, RunPlan
from hueflight.acquisition.precision_stop import PrecisionStop
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.snapshot import Snapshot
from hueflight.acquisition.summary import write_summary
from hueflight.calibration import Calibration
from hueflight.cli.app import app, errors
from hueflight.cli.output import show
from hueflight.devices.built_in_rigs import choose_rig
from hueflight.devices.illumination import GUIDANCE, CaptureKind
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.stopping import StopRule

CONNECT_S = 10.0
REFRESH_S = 0.2


@app.command
def capture(
    kind: CaptureKind = "scene",
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    instrument: str = "paper",
    frames: int = 0,
    seconds: float | None = None,
    photons: float | None = None,
    calibration: Path | None = None,
    until_depth_std: float | None = None,
    until_reflectance_std: float | None = None,
    share: float = 0.9,
    distance: float | None = None,
    note: str = "",
    rig: str | None = None,
    camera: str | None = None,
    illuminator: str | None = None,
    simulate: bool | None = None,
    scene: str = "fig1",
    yes: bool = False,
    json: bool = False,
) -> None:
    """Record a capture from the camera, and count what is lost and where.

    Ends at the first limit that is reached, or at Ctrl-C: the recording is whole either way.

    Parameters
    ----------
    kind
        scene, or one of those that a calibration is made of: reference, bands (one LED at a
        time), dark, flat.
    out
        The recording to write, NAME.mcap.
    instrument
        Preset or TOML file.
    frames
        Stop after so many; of kind bands, for each LED.
    seconds
        Stop after so long.
    photons
        Stop when the mean pixel has seen so many.
    calibration
        NAME.zarr; tells how well the pixels are known.
    until_depth_std
        Stop when depth is known this well, metres (standard deviation).
    until_reflectance_std
        Stop when the reflectance in every band is.
    share
        Of the pixels that must be.
    distance
        Of the target, metres; noted in the recording.
    note
        Noted in the recording.
    rig
        Address of the rig, such as usb:, simulated:fig1 or usb:0123ABCD+serial:/dev/ttyUSB0; takes
        the place of --simulate, --scene, --camera and --illuminator.
    camera
        Serial number, needed if several are plugged in.
    illuminator
        Its serial port, such as /dev/ttyUSB0; without one, something else drives the LEDs.
    simulate
        Use the simulated instrument, or insist on a camera; by default whatever is there.
    scene
        That the simulated instrument looks at.
    yes
        Begin at once, without asking whether all is in place.
    json
        Print the result as JSON.
    """
    if out.suffix != ".mcap":
        raise CaptureError(f"{out}: the name of a recording must end in .mcap")
    described = Instrument.load(instrument)
    metadata = {"note": note} if note else {}
    if distance is not None:
        metadata["distance_m"] = str(distance)
    plan = RunPlan(
        kind=kind, frames=frames, seconds=seconds, photons_per_pixel=photons, path=out,
        metadata=metadata,
        until=until_of(described, calibration, until_depth_std, until_reflectance_std, share),
    )  # fmt: skip
    plan.check()
    connect = choose_rig(
        described, uri=rig, simulate=simulate, serial=camera, illuminator=illuminator, scene=scene,
        say=lambda text: errors.print(f"[bold yellow]{text}[/]"),
    )  # fmt: skip
    acquisition = Acquisition(connect, described)
    with _ctrl_c(acquisition):
        try:
            _wait_for_rig(acquisition)
            if errors.is_terminal and not yes and not acquisition.snapshot.simulated:
                errors.print(GUIDANCE[kind])
                errors.input("Press Enter to begin. ")
            future = acquisition.run(plan)
            if errors.is_terminal:
                with Live(console=errors, transient=True) as live:
                    while not future.done():
                        live.update(_progress(acquisition.snapshot, plan))
                        time.sleep(REFRESH_S)
            result = future.result()
        finally:
            acquisition.close()
    summary = write_summary(out, result)
    show(f"Capture {out}", summary, json_wanted=json)
    if result.failure:
        raise HueflightError(f"the capture broke off: {result.failure}")


def until_of(
    instrument: Instrument,
    calibration: Path | None,
    depth_std: float | None,
    reflectance_std: float | None,
    share: float,
) -> PrecisionStop | None:
    """What must be known for a capture to end, or None if nothing is asked.

    Raises
    ------
    HueflightError
        If a wish can't be met, or there is no calibration for it.
    """
    if depth_std is None and reflectance_std is None:
        if calibration is not None:
            raise CaptureError(
                f"calibration {calibration}: say with --until-depth-std (m) or "
                "--until-reflectance-std what must be known"
            )
        return None
    rule = StopRule(depth_std=depth_std, reflectance_std=reflectance_std, share=share)
    if calibration is None:
        raise CaptureError("how well pixels are known is told by a calibration: --calibration")
    known = Calibration.load(calibration)
    known.require(instrument)
    return PrecisionStop(rule, known)


class _ctrl_c:  # noqa: N801 - reads as what it handles
    """Ctrl-C ends the run, and with it the program, cleanly; a second one insists."""

    def __init__(self, acquisition: Acquisition) -> None:
        self._acquisition = acquisition
        self._before: Any = None

    def __enter__(self) -> None:
        self._before = signal.signal(signal.SIGINT, self._pressed)

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _pressed(self, *_: object) -> None:
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


def _progress(snapshot: Snapshot, plan: RunPlan) -> Table:
    """How far it has come, and what it has cost."""
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
        table.add_row(name, value)
    return table
