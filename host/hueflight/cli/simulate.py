# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from hueflight import simulator
from hueflight.cli.choices import PRESETS, SCENE_NAMES
from hueflight.cli.options import WHOLE
from hueflight.cli.output import progress, show
from hueflight.errors import SceneError
from hueflight.files import refuse_existing
from hueflight.importers.captures import write_counts
from hueflight.model.instrument import Instrument
from hueflight.progress import task, tracked
from hueflight.recording import RecordingWriter
from hueflight.simulator import CaptureKind
from hueflight.simulator.simulated_captures import WHITE_PLANE_M

_LIGHT = simulator.SimulationSettings().white_detections


def simulate(
    scene: Annotated[str, Parameter(help=f"Scene to simulate: {SCENE_NAMES}.")] = "fig1",
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    capture: CaptureKind = "scene",
    instrument: Annotated[
        str, Parameter(help=f"Instrument: a preset ({PRESETS}) or the path of a TOML file.")
    ] = "paper",
    frames: Annotated[int, WHOLE] = 1000,
    distance: float | None = None,
    seed: Annotated[int, WHOLE] = 1,
    light: Annotated[
        float | None,
        Parameter(
            help="Number of photons per exposure that a pixel would detect from a white plane at "
            f"1 m. By default {_LIGHT:g}."
        ),
    ] = None,
    rays: Annotated[int, WHOLE] = 1,
    motion: Annotated[tuple[float, float, float], Parameter(negative_iterable=())] = (
        0.0,
        0.0,
        0.0,
    ),
    effects: Annotated[
        simulator.Effects | None,
        Parameter(name="*", group="Effects of real scenes and sensors", negative_iterable=()),
    ] = None,
    truth: Path | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Record a simulated capture.

    Every exposure is drawn, packed and written as the camera would send it.

    Parameters
    ----------
    scene : str, default "fig1"
        Scene to simulate.
    out : Path
        File to write: NAME.mcap for a recording of packets, or NAME.npz for counts alone, which
        is much faster.
    capture : str, default "scene"
        What to capture: the scene, or one of the captures that a calibration is made from. Those
        show a white plane instead of the scene (reference, bands for one LED at a time, dark,
        flat).
    instrument : str, default "paper"
        Instrument: a preset or the path of a TOML file.
    frames : int, default 1000
        Number of frames to record: for each LED in a capture of kind bands, and for each position
        of a scanned sensor.
    distance : float, optional
        Distance of the scene or of the white plane from the camera, in metres. By default each
        scene has its own; the white plane stands at 0.4 m.
    seed : int, default 1
        Seed of the random numbers that draw the photons. The sensor's defects do not depend on it.
    light : float, optional
        Number of photons per exposure from a white plane at 1 m.
    rays : int, default 1
        Number of rays along each side of a pixel, over which its light is averaged. With 4, for
        example, 16 rays per pixel give pixels at the edge of an object a share of both surfaces.
    motion : tuple of float, default (0, 0, 0)
        How far the scene moves during the capture: metres to the right, down and away from the
        camera.
    effects : Effects, optional
        Effects that an ideal model leaves out; all are off by default.
    truth : Path, optional
        File NAME.npz to write the ground truth to: depth and reflectance of each pixel, all
        depths that it sees with their shares of light, and what changed in the instrument.
    overwrite : bool, default False
        Replace an existing file of that name.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    described = Instrument.load(instrument)
    effects = effects or simulator.Effects()
    settings = simulator.SimulationSettings(effects=effects)
    if light is not None:
        settings = settings.replace(white_detections=light)
    options: dict[str, Any] = {} if distance is None else {"distance": distance}
    if capture != "scene" and rays != 1:
        raise SceneError(
            f"--rays {rays}: the white plane of a capture of kind {capture} has no edges; leave "
            "--rays out or capture a scene"
        )
    if capture != "scene" and any(motion):
        raise SceneError(
            f"--motion {motion}: the white plane of a capture of kind {capture} stands still; "
            "leave --motion out or capture a scene"
        )
    simulated = (
        simulator.scene(scene, described, rays=rays, motion=motion, **options)
        if capture == "scene"
        else None
    )
    refuse_existing(out, overwrite=overwrite)
    if truth is not None:
        if truth.suffix.lower() != ".npz":
            raise SceneError(f"--truth {truth}: the name must end in .npz")
        refuse_existing(truth, overwrite=overwrite)
    shown = progress(json_wanted=json)
    result = {"instrument": described.name, "capture": capture, "frames": frames}
    metadata: dict[str, Any] = {"capture": capture, "scene": scene, "simulated": True}
    if capture in ("reference", "bands"):
        metadata["distance_m"] = WHITE_PLANE_M if distance is None else distance
    if rays != 1:
        metadata["rays"] = result["rays"] = rays
    if any(motion):
        metadata["motion"] = result["motion"] = ", ".join(f"{part:g} m" for part in motion)
    if effects.active:
        text = ", ".join(f"{name} = {value}" for name, value in effects.active.items())
        metadata["effects"] = result["effects"] = text
    ending = out.suffix.lower()
    if ending == ".npz":
        with task(shown, "simulating", 1):
            counts = simulator.simulate_capture(
                capture, described, frames=frames, scene=simulated, settings=settings, seed=seed,
                **options,
            )  # fmt: skip
            write_counts(out, counts, described)
            shown.advance()
        result["photons"] = (
            int(counts[..., 1:].sum()) if described.sensor.reports_empty else int(counts.sum())
        )
    elif ending == ".mcap":
        packets = simulator.simulate_packets(
            capture, described, frames=frames, scene=simulated, settings=settings, seed=seed,
            **options,
        )  # fmt: skip
        steps = len(described.bands) if capture == "bands" else 1
        total = frames * steps * described.sensor.scan_steps
        with RecordingWriter(
            out,
            described,
            metadata=metadata,
            overwrite=overwrite,
        ) as record:
            for packet in tracked(packets, shown, "frames", total):
                record.write(packet)
        result["bytes"] = out.stat().st_size
    else:
        raise SceneError(f"{out}: the name must end in .mcap (packets) or .npz (counts)")
    if truth is not None:
        parts = simulator.exposures(
            capture, described, scene=simulated, settings=settings, **options
        )
        # of one LED at a time, the truth is that of all together
        of_all = settings if capture == "bands" else parts[0].settings
        simulator.write_truth(truth, parts[0].scene, described, of_all)
        result["truth"] = str(truth)
    show(f"Capture {out}", result, json_wanted=json)
