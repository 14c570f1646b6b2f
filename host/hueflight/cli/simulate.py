"""hueflight simulate"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from hueflight import simulator
from hueflight.cli.app import app
from hueflight.cli.output import progress, show
from hueflight.errors import SceneError
from hueflight.importers.captures import write_counts
from hueflight.model.instrument import Instrument
from hueflight.progress import task, tracked
from hueflight.recording import RecordingWriter


@app.command
def simulate(
    scene: str = "fig1",
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    capture: Literal["scene", "reference", "bands", "dark", "flat"] = "scene",
    instrument: str = "paper",
    frames: int = 1000,
    distance: float | None = None,
    seed: int = 1,
    light: float | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Record a simulated capture: every exposure drawn, packed and written like a real one.

    Parameters
    ----------
    scene
        What to look at: fig1, fig7, colorchecker, plane, staircase or empty.
    out
        NAME.mcap for a recording of packets, NAME.npz for counts alone (much faster).
    capture
        scene, or one of the captures that a calibration is made of (a white plane).
    instrument
        Preset or TOML file.
    frames
        Exposures (for each LED of capture `bands`, for each position of a scanned sensor).
    distance
        Of the scene or the white plane, metres, where it has one.
    seed
        Draws the photons; the sensor's defects are always the same.
    light
        Photons that a white plane at 1 m gives per exposure.
    overwrite
        Replace a file of that name.
    json
        Print the result as JSON.
    """
    described = Instrument.load(instrument)
    settings = simulator.SimulationSettings()
    if light is not None:
        settings = settings.replace(white_detections=light)
    options: dict[str, Any] = {} if distance is None else {"distance": distance}
    looked_at = simulator.scene(scene, described, **options) if capture == "scene" else None
    if out.exists() and not overwrite:
        raise SceneError(f"{out} exists: choose another name or say --overwrite")
    shown = progress(json_wanted=json)
    result = {"instrument": described.name, "capture": capture, "frames": frames}
    if out.suffix == ".npz":
        with task(shown, "simulating", 1):
            counts = simulator.simulate_capture(
                capture, described, frames=frames, scene=looked_at, settings=settings, seed=seed,
                **options,
            )  # fmt: skip
            write_counts(out, counts, described)
            shown.advance()
        result["photons"] = (
            int(counts[..., 1:].sum()) if described.sensor.reports_empty else int(counts.sum())
        )
    elif out.suffix == ".mcap":
        packets = simulator.simulate_packets(
            capture, described, frames=frames, scene=looked_at, settings=settings, seed=seed,
            **options,
        )  # fmt: skip
        leds_in_turn = len(described.bands) if capture == "bands" else 1
        total = frames * leds_in_turn * described.sensor.scan_steps
        with RecordingWriter(
            out,
            described,
            metadata={"capture": capture, "scene": scene, "simulated": True},
            overwrite=overwrite,
        ) as record:
            for packet in tracked(packets, shown, "frames", total):
                record.write(packet)
        result["bytes"] = out.stat().st_size
    else:
        raise SceneError(f"{out}: the name must end in .mcap (packets) or .npz (counts)")
    show(f"Capture {out}", result, json_wanted=json)
