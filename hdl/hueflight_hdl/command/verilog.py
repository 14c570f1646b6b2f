"""hueflight-hdl verilog"""

from __future__ import annotations

from pathlib import Path

from ..boards.target import Options
from ..boards.targets import find_target
from ..project import estimate, write_project
from .app import Said, app


@app.command
def verilog(
    design: str,
    /,
    *,
    board: str,
    folder: Path | None = None,
    pins: Path | None = None,
    lanes: int | None = None,
    count: bool = False,
) -> None:
    """Write a design as Verilog with constraints and build scripts, for any toolchain.

    Parameters
    ----------
    design
        illuminator or camera.
    board
        For example ulx3s-85f, or the paper's xem3010 and xem6310.
    folder
        Where everything is written; by default build/DESIGN-BOARD-project.
    pins
        TOML file that names the pins of a board whose pins we can't know.
    lanes
        Codes per clock at the camera's sensor port: 1, 2, 4 or 8.
    count
        Also estimate the resources with yosys.
    """
    said = Said()
    target = find_target(design, board, Options(pins=pins, lanes=lanes))
    where = folder or Path("build") / f"{design}-{board}-project"
    said(f"writing {design} for {board}")
    for path in write_project(target, where):
        print(path)
    if count:
        said("estimating resources with yosys")
        for kind, number in estimate(target, where).items():
            print(f"{kind}: {number}")
        print("an estimate by yosys before place and route; the vendor's tools will differ")
