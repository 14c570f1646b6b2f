# SPDX-License-Identifier: Apache-2.0
"""``--program``: which tool loads a bitstream, how it is called, and what is said without one."""

import stat
from pathlib import Path

import pytest

from hueflight_hdl.boards.target import TargetError
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.program import load, loading_command
from hueflight_hdl.build.report import BuildError, BuildReport, ClockResult
from hueflight_hdl.cli import main
from hueflight_hdl.toolchain import ToolError

FILES = Path(__file__).parents[1] / "boards" / "examples"
BOARDS = {
    "ulx3s-85f": ["-b", "ulx3s"],
    "ecpix5-85f": ["-c", "ft2232"],
    "hx8k": ["-b", "ice40_generic", "-c", "ft2232"],
}


@pytest.fixture
def no_tools(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A computer without a loader; returns a folder that is on its path."""
    for name in ("OPENFPGALOADER", "ECPPROG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    return tmp_path


def install(folder: Path, name: str) -> None:
    """Put a tool on the path that prints how it was called."""
    tool = folder / name
    tool.write_text(f'#!/bin/sh\necho {name} "$@"\n')
    tool.chmod(tool.stat().st_mode | stat.S_IXUSR)


@pytest.mark.parametrize("board", BOARDS)
def test_each_board_is_named_to_the_loader(no_tools: Path, board: str):
    install(no_tools, "openFPGALoader")
    install(no_tools, "ecpprog")
    target = find_target("illuminator", board)
    assert loading_command(target, "top.bit") == ["openFPGALoader", *BOARDS[board], "top.bit"]
    printed = load(target, no_tools / "top.bit")
    assert printed.split() == ["openFPGALoader", *BOARDS[board], "top.bit"]


def test_ecpprog_serves_for_ecp5_alone(no_tools: Path):
    install(no_tools, "ecpprog")
    target = find_target("illuminator", "ulx3s-85f")
    assert loading_command(target, "top.bit") == ["ecpprog", "-S", "top.bit"]
    with pytest.raises(ToolError, match="openFPGALoader was not found"):
        loading_command(find_target("illuminator", "hx8k"), "top.bin")


def test_a_missing_tool_is_told_before_the_build(no_tools: Path, tmp_path: Path, capsys):
    words = ["build", "illuminator", "--board", "hx8k", "--folder", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--program"])
    assert ended.value.code == 1
    assert "openFPGALoader was not found" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("reached_mhz", "code", "loaded"), [(60.0, 0, True), (51.0, 2, False)])
def test_a_bitstream_is_loaded_if_every_clock_has_its_margin(
    no_tools: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    reached_mhz: float,
    code: int,
    loaded: bool,
):
    install(no_tools, "openFPGALoader")
    clocks = {"sync": ClockResult(50.0, reached_mhz)}
    report = BuildReport(
        design="illuminator",
        board="hx8k",
        lanes=None,
        bitstream=no_tools / "top.bin",
        sha256="",
        used={},
        clocks=clocks,
        seed=1,
        tried={},
        required=0.1,
    )
    monkeypatch.setattr("hueflight_hdl.cli.build.build_target", lambda *_, **__: report)
    with pytest.raises(SystemExit) as ended:
        main(["build", "illuminator", "--board", "hx8k", "--program", "--json"])
    assert (ended.value.code or 0) == code
    assert (f"{' '.join(BOARDS['hx8k'])} top.bin" in capsys.readouterr().err) == loaded


def test_a_board_file_says_how_its_board_is_loaded(no_tools: Path):
    install(no_tools, "openFPGALoader")
    text = (FILES / "blackice.toml").read_text()
    path = no_tools / "own.toml"
    path.write_text(text)
    with pytest.raises(BuildError, match=r'loader = \["-c", "ft2232"\]'):
        loading_command(find_target("illuminator", str(path)), "top.bin")
    path.write_text('loader = ["-c", "dirtyJtag"]\n' + text)
    found = loading_command(find_target("illuminator", str(path)), "top.bin")
    assert found == ["openFPGALoader", "-c", "dirtyJtag", "top.bin"]
    path.write_text('loader = "dirtyJtag"\n' + text)
    with pytest.raises(TargetError, match="loader = 'dirtyJtag': must be a list"):
        find_target("illuminator", str(path))
