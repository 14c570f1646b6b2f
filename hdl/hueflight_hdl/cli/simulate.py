# SPDX-License-Identifier: Apache-2.0
"""The subcommand ``hueflight-hdl simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..boards.target import TargetError
from .app import Progress, app


@app.command
def simulate(
    design: str,
    /,
    *,
    folder: Path | None = None,
    signals: Annotated[bool, Parameter(negative=())] = False,
    frames: int = 20,
    occupancy: float = 0.3,
) -> None:
    """Simulate a design and write what it sends.

    For the illuminator: one pulse train of the paper's schedule, as a VCD file for a waveform
    viewer with a save file for GTKWave, and as an SVG drawing. For the camera: the packets of a
    capture with the synthetic sensor.

    Parameters
    ----------
    design
        Design to simulate: illuminator or camera.
    folder
        Output folder. The default is build/simulate-DESIGN.
    signals
        Also write every signal of the illuminator's gateware, inner ones too, as a VCD file of
        9 MB with a save file for GTKWave. This takes up to a minute.
    frames
        Number of frames that the simulated camera captures.
    occupancy
        Fraction of the simulated camera's pixels that detect a photon in a frame, from 0 to 1.
    """
    where = folder or Path("build") / f"simulate-{design}"
    if design == "illuminator":
        where.mkdir(parents=True, exist_ok=True)
        _illuminator(where, signals=signals)
    elif design == "camera":
        if signals:
            raise TargetError("--signals: belongs to the illuminator")
        if frames < 1:
            raise TargetError(f"--frames {frames}: must be 1 or more")
        if not 0 <= occupancy <= 1:
            raise TargetError(f"--occupancy {occupancy:g}: must be from 0 to 1")
        where.mkdir(parents=True, exist_ok=True)
        _camera(where, frames, occupancy)
    else:
        raise TargetError(f"there is no design {design!r}: choose one of illuminator, camera")


def _illuminator(folder: Path, *, signals: bool) -> None:
    from ..testbench.illuminator_waveform import (
        draw,
        dump_train,
        record_train,
        write_save_file,
        write_vcd,
    )

    progress = Progress()
    progress("compiling and running the illuminator")
    waveform = record_train()
    for name, write in (("train.vcd", write_vcd), ("train.svg", draw)):
        write(waveform, folder / name)
        print(folder / name)
    write_save_file(waveform, folder / "train.vcd", folder / "train.gtkw")
    print(folder / "train.gtkw")
    if signals:
        progress("running the illuminator again with all its signals")
        for path in dump_train(folder):
            print(path)


def _camera(folder: Path, frames: int, occupancy: float) -> None:
    from ..camera.camera import CameraConfig
    from ..testbench.camera_capture import camera_packets

    progress = Progress()
    progress("compiling and running the camera")
    path = folder / "packets.bin"
    size = 0
    with path.open("wb") as file:
        for content in camera_packets(CameraConfig(), frames=frames, occupancy=occupancy):
            size += file.write(content)
    print(f"{path}: {frames} frames in {size} bytes")
