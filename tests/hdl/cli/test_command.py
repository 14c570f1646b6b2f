# SPDX-License-Identifier: Apache-2.0
"""The command: help, refusals without tracebacks, projects for other toolchains."""

import json
import subprocess
import sys

import pytest
from amaranth.hdl import Assert, Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.cli import main
from hueflight_hdl.control.register_file import RegisterFile
from hueflight_hdl.proofs.proof import Proof
from hueflight_protocol import Frame, PacketParser
from hueflight_protocol.registers import RegisterMap


def fails(capsys, *words):
    with pytest.raises(SystemExit) as ended:
        main(words)
    said = capsys.readouterr().err
    assert "Traceback" not in said
    return ended.value.code, said


def test_an_interrupted_elaboration_ends_with_one_message(tmp_path):
    words = ["verilog", "camera", "--board", "ulx3s-85f", "--set", "buffer_words=100"]
    run = f"from hueflight_hdl.cli import main; main({[*words, '--folder', str(tmp_path)]})"
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    _, message = done.stderr.splitlines()  # after the line of progress
    assert message == "error: buffer_words = 100: must be a power of two from 32 up"


def test_help_names_every_command(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert not ended.value.code
    said = capsys.readouterr().out
    for command in ("build", "verilog", "simulate", "prove"):
        assert command in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["build", "illuminator", "--board", "de10"], "one of ulx3s-85f, ulx3s-45f"),
        (["build", "radio", "--board", "hx8k"], "one of camera, illuminator"),
        (["build", "illuminator", "--board", "hx8k", "--seeds", "0"], "--seeds 0"),
        (["build", "illuminator", "--board", "hx8k", "--accept-margin", "-5"], "-5"),
        (["verilog", "camera", "--board", "xem6310"], "not guessed"),
        (["verilog", "camera", "--board", "xem6310", "--pins", "none.toml"], "none.toml"),
        (["verilog", "camera", "--core"], "--core for the illuminator"),
        (["verilog", "illuminator", "--core", "--count"], "--count need a board"),
        (["registers", "radio"], "one of illuminator, camera"),
        (["registers", "camera", "--format", "pdf"], "must be one of json, svd, c"),
        (["registers", "camera", "--pins", "a.toml"], "--pins a.toml: give --board too"),
        (["registers", "camera", "--set", "channels=2"], "choose from rows, cols"),
        (["prove", "radio"], "one of illuminator, camera"),
        (["prove", "camera", "--only", "magic"], "camera-stable"),
        (["simulate", "radio"], "one of illuminator, camera"),
        (["simulate", "camera", "--frames", "0"], "--frames 0"),
        (["simulate", "camera", "--occupancy", "2"], "from 0 to 1"),
    ],
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_impossible_requests_are_refused_with_a_message(capsys, words, said):
    code, message = fails(capsys, *words)
    assert code == 1
    assert message.startswith("error: ")
    assert said in message


def test_projects_for_the_boards_of_the_paper(builder, tmp_path, capsys):
    pins = tmp_path / "pins.toml"
    letters = iter("ABCDEFGHJKLMNPRTUV")
    single = [f'{name} = "{next(letters)}1"' for name in _SINGLE]
    pins.write_text(
        "\n".join(
            [
                'iostandard = "LVCMOS33"',
                "clock_hz = 100e6",
                *single,
                f"led_pulse = {[f'{c}2' for c in 'ABCDEFGHJ']}",
                f"marker = {[f'{c}3' for c in 'ABCDEFGH']}",
            ]
        )
    )
    folder = tmp_path / "project"
    words = ["verilog", "illuminator", "--board", "xem3010"]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--pins", str(pins), "--folder", str(folder)])
    assert not ended.value.code
    listed = capsys.readouterr().out.split()
    assert {path.rsplit("/", 1)[-1] for path in listed} >= {
        "top.v",
        "top.ucf",
        "top.xst",
        "top.prj",
    }
    constraints = (folder / "top.ucf").read_text()
    assert 'NET "clock_0__io" LOC=A1;' in constraints
    assert "10.0 ns" in constraints
    assert "xc3s1500fg320-4" in (folder / "top.xst").read_text()
    assert "module top" in (folder / "top.v").read_text()


_SINGLE = ("clock", "rx", "tx", "trigger", "trigger_out", "frame_sync", "missed", "armed")


def test_properties_are_listed_and_one_is_verified(prover, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["prove", "illuminator", "--list"])
    assert not ended.value.code
    listed = capsys.readouterr().out.splitlines()
    assert all("for all time" in line or "for the first" in line for line in listed)
    with pytest.raises(SystemExit) as ended:
        main(["prove", "illuminator", "--only", "illuminator-watchdog"])
    assert not ended.value.code
    assert capsys.readouterr().out.startswith("verified: The board is armed only if")


def test_a_false_property_is_reported_with_exit_code_2(prover, capsys, monkeypatch):
    class Never(wiring.Component):
        def __init__(self):
            super().__init__({"i": In(1)})

        def elaborate(self, platform):
            m = Module()
            m.d.comb += Assert(~self.i)
            return m

    false = Proof("false", "An input is never high.", Never, depth=2)
    monkeypatch.setattr("hueflight_hdl.proofs.illuminator.PROOFS", (false,))
    code, said = fails(capsys, "prove", "illuminator")
    assert code == 2
    assert "1 of 1 properties do not hold" in said


@pytest.mark.slow
def test_simulations_write_a_waveform_and_packets(simulator, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["simulate", "illuminator", "--signals", "--folder", str(tmp_path)])
    assert not ended.value.code
    assert "bench.top.core.generator.sequencer." in (tmp_path / "signals.gtkw").read_text()
    assert (tmp_path / "signals.vcd").stat().st_size > 1e6
    changes = (tmp_path / "train.vcd").read_text()
    assert "$timescale 1 ps" in changes
    assert "led8" in changes
    assert (tmp_path / "train.svg").read_text().startswith("<svg")
    with pytest.raises(SystemExit) as ended:
        main(["simulate", "camera", "--frames", "3", "--folder", str(tmp_path)])
    assert not ended.value.code
    parser = PacketParser()
    packets = list(parser.feed((tmp_path / "packets.bin").read_bytes()))
    assert sum(isinstance(packet.content, Frame) for packet in packets) == 3
    assert parser.report.damaged == 0


def test_registers_are_written_for_the_sizes_that_were_chosen(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(
            ["registers", "illuminator", "--set", "channels=4", "--out", str(tmp_path / "map.json")]
        )
    assert not ended.value.code
    entries = json.loads((tmp_path / "map.json").read_text())["registers"]
    (limits,) = (entry for entry in entries if entry["name"] == "limit")
    assert limits["count"] == [4]
    with pytest.raises(SystemExit):
        main(["registers", "camera", "--format", "svd"])
    assert capsys.readouterr().out.startswith("<?xml")


@pytest.mark.parametrize(("design", "board"), [("illuminator", "hx8k"), ("camera", "ulx3s-85f")])
def test_registers_of_a_board_are_those_that_it_reports(monkeypatch, capsys, design, board):
    """The fingerprint in the file is the one that the gateware has as a constant."""
    built: list[RegisterMap] = []
    original = RegisterFile.__init__

    def record(self, registers, **rest):
        built.append(registers)
        original(self, registers, **rest)

    monkeypatch.setattr(RegisterFile, "__init__", record)
    target = find_target(design, board)
    target.platform().prepare(target.top(), "top")
    with pytest.raises(SystemExit):
        main(["registers", design, "--board", board])
    found = json.loads(capsys.readouterr().out)
    assert [found["fingerprint"]] == [registers.fingerprint for registers in built]
    (clock,) = (entry for entry in found["registers"] if entry["name"] == "clock_hz")
    rate = target.clocks_mhz["pulse" if design == "illuminator" else "sync"]
    assert clock["reset"] == pytest.approx(1e6 * rate)
