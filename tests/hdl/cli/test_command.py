"""The command: help, refusals without tracebacks, projects for other toolchains."""

import pytest

from hueflight_hdl.command import main


def fails(capsys, *words):
    with pytest.raises(SystemExit) as ended:
        main(words)
    said = capsys.readouterr().err
    assert "Traceback" not in said
    return ended.value.code, said


def test_help_names_every_command(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert not ended.value.code
    said = capsys.readouterr().out
    for command in ("build", "verilog"):
        assert command in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["build", "illuminator", "--board", "de10"], "one of ulx3s-85f, ecpix5-85f, hx8k"),
        (["build", "radio", "--board", "hx8k"], "one of camera, illuminator"),
        (["build", "illuminator", "--board", "hx8k", "--seeds", "0"], "--seeds 0"),
        (["build", "illuminator", "--board", "hx8k", "--accept-margin", "-5"], "-5"),
        (["verilog", "camera", "--board", "xem6310"], "not guessed"),
        (["verilog", "camera", "--board", "xem6310", "--pins", "none.toml"], "none.toml"),
    ],
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_what_can_t_be_done_is_said_in_a_sentence(capsys, words, said):
    code, message = fails(capsys, *words)
    assert code == 1
    assert message.startswith("error: ")
    assert said in message


def test_projects_of_the_paper_s_boards(builder, tmp_path, capsys):
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


_SINGLE = ("clock", "rx", "tx", "trigger", "trigger_out", "frame_sync", "armed")
