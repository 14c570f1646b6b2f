"""hueflight-hdl simulate"""

from __future__ import annotations

from pathlib import Path

from ..boards.target import TargetError
from .app import Said, app


@app.command
def simulate(
    design: str,
    /,
    *,
    folder: Path | None = None,
    frames: int = 20,
    occupancy: float = 0.3,
) -> None:
    """Run a design in compiled simulation and write what its pins do.

    Of the illuminator, one train of the paper's schedule, as VCD for a waveform viewer and drawn
    as SVG; of the camera, the packets of a capture of the synthetic sensor.

    Parameters
    ----------
    design
        illuminator or camera.
    folder
        Where the files are written; by default build/simulate-DESIGN.
    frames
        Of the camera's capture.
    occupancy
        Share of pixels that see a photon, 0 to 1.
    """
    where = folder or Path("build") / f"simulate-{design}"
    if design == "illuminator":
        where.mkdir(parents=True, exist_ok=True)
        _illuminator(where)
    elif design == "camera":
        if frames < 1:
            raise TargetError(f"--frames {frames}: must be 1 or more")
        if not 0 <= occupancy <= 1:
            raise TargetError(f"--occupancy {occupancy:g}: must be from 0 to 1")
        where.mkdir(parents=True, exist_ok=True)
        _camera(where, frames, occupancy)
    else:
        raise TargetError(f"no design {design!r}: one of illuminator, camera")


def _illuminator(folder: Path) -> None:
    from ..simulation.illuminator_waveform import draw, record_train, write_vcd

    said = Said()
    said("compiling and running the illuminator")
    waveform = record_train()
    for name, write in (("train.vcd", write_vcd), ("train.svg", draw)):
        write(waveform, folder / name)
        print(folder / name)


def _camera(folder: Path, frames: int, occupancy: float) -> None:
    from ..designs.camera import CameraConfig
    from ..simulation.camera_run import camera_packets

    said = Said()
    said("compiling and running the camera")
    path = folder / "packets.bin"
    size = 0
    with path.open("wb") as file:
        for content in camera_packets(CameraConfig(), frames=frames, occupancy=occupancy):
            size += file.write(content)
    print(f"{path}: {frames} frames in {size} bytes")
