# SPDX-License-Identifier: Apache-2.0
"""Real builds: margins, bit-identical repetition, and what happens where a clock falls short."""

import json
import re

import pytest

from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.build import SEEDS, build
from hueflight_hdl.build.report import BuildError
from hueflight_hdl.cli import build as build_command
from hueflight_hdl.cli import main


def test_a_build_repeated_is_the_same_to_the_bit(builder, small, tmp_path):
    first = build(small(12), tmp_path / "first")
    second = build(small(12), tmp_path / "second")
    assert first.bitstream.read_bytes() == second.bitstream.read_bytes()
    assert first.sha256 == second.sha256
    assert first.reached
    assert list(first.tried) == [1]
    assert (tmp_path / "first/report.json").read_text() == first.to_json() == second.to_json()
    assert build(small(12), tmp_path / "other", seeds=[2]).sha256 != first.sha256


def structure(folder):
    """What was placed and routed: every line but the content of memories."""
    (routed,) = (path for path in folder.glob("top.*") if path.suffix in (".asc", ".config"))
    parts = re.split(r"(?m)^(?=\.)", routed.read_text())
    return [part for part in parts if not part.startswith((".ram_data", ".bram_init"))]


def test_the_content_of_memories_does_not_move_anything(builder, with_constants, tmp_path):
    """The hash of the sources is such a content; otherwise any change would move the margins."""
    contents = {"one": [5, 7, 11], "two": [0xFFFF_FFFF, 1, 2, 3, 0x1234_5678]}
    reports = {
        name: build(with_constants(content), tmp_path / name) for name, content in contents.items()
    }
    names = [
        list(json.loads((tmp_path / name / "top.json").read_text())["modules"]) for name in contents
    ]
    assert names[0] == names[1]
    assert structure(tmp_path / "one") == structure(tmp_path / "two")
    assert reports["one"].clocks == reports["two"].clocks
    assert reports["one"].sha256 != reports["two"].sha256


@pytest.mark.slow
def test_every_seed_is_tried_and_the_best_is_kept_where_none_reaches(builder, small, tmp_path):
    report = build(small(900), tmp_path, seeds=[3, 4, 5])
    assert not report.reached
    assert list(report.tried) == [3, 4, 5]
    assert report.tried[report.seed] == max(report.tried.values())
    alone = build(small(900), tmp_path / "alone", seeds=[report.seed])
    assert alone.sha256 == report.sha256


def test_the_command_reports_the_result(builder, small, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(build_command, "find_target", lambda *_: small(12))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["build", "illuminator", "--board", "small", "--json"])
    assert not ended.value.code
    said = capsys.readouterr()
    assert json.loads(said.out)["reached"] is True
    assert "synthesis" in said.err
    assert (tmp_path / "build/illuminator-small/top.bin").exists()

    monkeypatch.setattr(build_command, "find_target", lambda *_: small(900))
    with pytest.raises(SystemExit) as ended:
        main(["build", "illuminator", "--board", "small", "--seeds", "1"])
    assert ended.value.code == 2
    assert "timing margin missed" in capsys.readouterr().err


@pytest.mark.slow
def test_a_smaller_margin_is_accepted_with_a_note(builder, small, tmp_path, monkeypatch, capsys):
    reached = build(small(12), tmp_path).clocks["sync"].reached_mhz
    close = small(reached / 1.05)
    monkeypatch.setattr(build_command, "find_target", lambda *_: close)
    words = ["build", "illuminator", "--board", "small", "--seeds", "1", "--folder", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main([*words, "--accept-margin", "4"])
    assert not ended.value.code
    assert (
        "a timing margin of 4.0% was accepted instead of the usual 10%" in capsys.readouterr().err
    )


@pytest.mark.slow
def test_geared_pins_on_both_edges_are_refused_with_the_reason(builder, two_edges, tmp_path):
    with pytest.raises(BuildError, match="must all be on the left edge of the device, or all on"):
        build(two_edges, tmp_path)


@pytest.mark.slow
def test_an_external_clock_is_placed_and_routed(builder, two_clocks, tmp_path):
    """Two PLLs in a row with the choice between them, and the clock output's register."""
    report = build(two_clocks, tmp_path)
    assert report.reached, report.to_json()
    placed = json.loads((tmp_path / "nextpnr.json").read_text())["utilization"]
    assert placed["EHXPLLL"]["used"] == 2
    assert placed["IOLOGIC"]["used"] + placed["SIOLOGIC"]["used"] == 2  # LED and clock output


@pytest.mark.slow
def test_fine_delay_lines_are_in_the_output_blocks(builder, fine_outputs, tmp_path):
    """Each is between its output register and its pin; nextpnr routes what moves one of them."""
    report = build(fine_outputs, tmp_path)
    assert report.reached, report.to_json()
    (routed,) = tmp_path.glob("top.config")
    assert routed.read_text().count(".DELAY.OUTDEL ENABLED") == 2


def test_ise_boards_are_not_built_here(small, tmp_path):
    target = small(12)
    ise = type(target)(**{**vars(target), "family": "xc3s"})
    with pytest.raises(BuildError, match="hueflight-hdl verilog illuminator --board small"):
        build(ise, tmp_path)
    with pytest.raises(BuildError, match="seeds is empty"):
        build(target, tmp_path, seeds=[])


@pytest.mark.slow
@pytest.mark.timeout(3000)  # up to eight placements of a few minutes each
@pytest.mark.parametrize(("board", "reached_with"), [("hx8k", 1), ("ulx3s-85f", 1)])
def test_illuminator_has_its_margin_and_repeats(builder, tmp_path, board, reached_with):
    """Seeds are tried as the command does, but first the one that reached the margin before."""
    target = find_target("illuminator", board)
    seeds = [reached_with, *(seed for seed in SEEDS if seed != reached_with)]
    report = build(target, tmp_path, seeds=seeds)
    assert report.reached, report.to_json()
    again = build(target, tmp_path / "again", seeds=[report.seed])
    assert again.sha256 == report.sha256
