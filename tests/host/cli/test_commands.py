# SPDX-License-Identifier: Apache-2.0
"""The commands as a person types them: results, messages, exit codes; never a traceback."""

import ast
import inspect
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from cyclopts import App

from hueflight.analysis import flatten, illumination_pattern
from hueflight.batch import job
from hueflight.calibration import Calibration
from hueflight.cli import main
from hueflight.cli.app import COMMANDS, application
from hueflight.cli.output import show
from hueflight.importers import read_counts, read_image
from hueflight.reconstruction import reconstruct

TOML = """
name = "bench"
[sensor]
rows = 12
cols = 10
code_bits = 9
bin_width_ns = 0.642
direction = "reverse"
code_zero = "no photon"
pixel_width_um = 200
pixel_height_um = 150
frame_rate_hz = 480
exposure_ms = 1.0
dark_count_hz = 25
[timing]
period_ns = 320
latency_ns = 25
[lens]
focal_length_mm = 8
[[bands]]
name = "red"
wavelength_nm = 630
delay_ns = 0
[[bands]]
name = "green"
wavelength_nm = 525
delay_ns = 60
[[bands]]
name = "blue"
wavelength_nm = 450
delay_ns = 130
"""


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a small instrument's file, as working directory."""
    (tmp_path / "bench.toml").write_text(TOML)
    monkeypatch.chdir(tmp_path)
    return tmp_path


class Run:
    """What a command left behind."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def json(self) -> dict:
        return json.loads(self.out)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]):
    def run(*words: str) -> Run:
        try:
            main(words)
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else int(bool(stop.code))
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return Run(code, captured.out, captured.err)

    return run


def test_captures_calibration_and_image(bench: Path, run) -> None:
    reference = run(
        "simulate", "--capture", "reference", "--instrument", "bench.toml", "--frames", "4000",
        "-o", "reference.npz", "--json",
    )  # fmt: skip
    assert reference.code == 0, reference.err
    assert reference.json["photons"] > 0
    scene = run(
        "simulate", "plane", "--distance", "0.8", "--instrument", "bench.toml", "--frames", "600",
        "-o", "scene.mcap", "--json",
    )  # fmt: skip
    assert scene.code == 0, scene.err
    information = run("info", "scene.mcap", "--json")
    assert information.code == 0, information.err
    assert information.json["frames"] == 600
    assert information.json["instrument"] == "bench"
    calibration = run("calibrate", "reference.npz", "-d", "0.4", "-o", "cal.zarr", "--json")
    assert calibration.code == 0, calibration.err
    assert calibration.json["windows"] == 3
    image = run("reconstruct", "scene.mcap", "-c", "cal.zarr", "-o", "scene.zarr", "--json")
    assert image.code == 0, image.err
    # 120 pixels of some 5 cm each: the median is good to 0.6 cm
    assert image.json["depth_50_percent_m"] == pytest.approx(0.8, abs=0.03)
    assert (bench / "scene.png").read_bytes().startswith(b"\x89PNG")
    stored = xr.open_zarr(bench / "scene.zarr")
    assert stored["depth"].dims == ("row", "col")
    np.testing.assert_array_equal(stored["wavelength"], [630, 525, 450])


def test_check_says_whether_a_calibration_holds(bench: Path, run) -> None:
    for name, seed in (("first", "1"), ("later", "2")):
        done = run(
            "simulate", "--capture", "reference", "--instrument", "bench.toml",
            "--frames", "4000", "--seed", seed, "-o", f"{name}.npz", "--json",
        )  # fmt: skip
        assert done.code == 0, done.err
    assert run("calibrate", "first.npz", "-d", "0.4", "-o", "checked.zarr").code == 0
    words = ("check", "checked.zarr", "first.npz", "--page", "check.html")
    same = run(*words, "--json")
    assert same.code == 0, same.out + same.err
    assert same.json["holds"]
    page = (bench / "check.html").read_text()
    assert "The calibration holds" in page
    assert page.count("data:image/png;base64,") == 2
    assert run(*words).code == 1  # the page exists
    moved = run("check", "checked.zarr", "first.npz", "-d", "0.5")
    assert moved.code == 4
    assert "no longer holds" in moved.out
    assert "10.0 cm nearer" in " ".join(moved.out.split())


def test_one_led_at_a_time_goes_into_a_calibration(bench: Path, run) -> None:
    for kind, frames in (("reference", 4000), ("bands", 3000), ("dark", 500), ("flat", 20000)):
        done = run(
            "simulate", "--capture", kind, "--instrument", "bench.toml", "--frames", str(frames),
            "-o", f"{kind}.npz", "--json",
        )  # fmt: skip
        assert done.code == 0, done.err
    done = run(
        "calibrate", "reference.npz", "-d", "0.4", "-o", "cal.zarr", "--bands", "bands.npz",
        "--dark", "dark.npz", "--flat", "flat.npz", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["one_led_templates"]
    assert done.json["measured_bin_widths"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["info", "nothing.mcap"], "nothing.mcap"),
        (["info", "foreign.mcap"], "foreign.mcap"),
        (["simulate", "castle", "-o", "x.npz"], "castle"),
        (["simulate", "-o", "x.txt", "--frames", "1"], "must end in .mcap (packets) or .npz"),
        (["simulate", "-o", "x.npz", "--tail-share", "2"], "effects.tail_share = 2.0"),
        (["simulate", "-o", "x.npz", "--truth", "x.txt"], "--truth x.txt: the name must end in"),
        (["simulate", "--capture", "dark", "--rays", "2", "-o", "x.npz"], "--rays 2"),
        (["simulate", "-o", "x.npz", "--instrument", "papper"], "no instrument 'papper'"),
        (
            ["calibrate", "foreign.npz", "-d", "0.4", "-o", "c.zarr"],
            "'foreign.npz' is a text file, not a ZIP archive (.npz)",
        ),
        (
            ["calibrate", "text.txt", "-d", "0.4", "-o", "c.zarr"],
            "'text.txt' is a text file, and counts are not read from files that end in '.txt'",
        ),
        (["calibrate", "bare.npy", "-d", "0.4", "-o", "c.zarr"], "does not say which instrument"),
        (
            ["calibrate", "bare.npy", "-d", "0.4", "-o", "c.zarr", "--instrument", "bench.toml"],
            "shape (3, 3, 3)",
        ),
        (["reconstruct", "bare.npy", "-c", "none.zarr", "-o", "i.zarr"], "none.zarr"),
        (["demo", "--frames", "3"], "at least 100 frames"),
    ],
)
def test_mistakes_get_one_sentence(bench: Path, run, words: list[str], message: str) -> None:
    (bench / "foreign.mcap").write_bytes(b"not a recording at all")
    (bench / "foreign.npz").write_bytes(b"PK but no archive")
    (bench / "text.txt").write_text("hello")
    np.save(bench / "bare.npy", np.ones((3, 3, 3), np.uint16))
    failed = run(*words)
    assert failed.code == 1
    assert failed.err.startswith("error: ")
    assert message in " ".join(failed.err.split())


def test_nothing_is_overwritten_unasked(bench: Path, run) -> None:
    words = ["simulate", "plane", "--instrument", "bench.toml", "--frames", "5", "-o", "a.npz"]
    assert run(*words).code == 0
    before = (bench / "a.npz").read_bytes()
    refused = run(*words)
    assert refused.code == 1
    assert "'a.npz' exists already" in refused.err
    assert "--overwrite" in refused.err
    assert (bench / "a.npz").read_bytes() == before
    assert run(*words, "--overwrite").code == 0


def test_help_names_every_command_and_the_exit_codes(run) -> None:
    shown = run("--help")
    assert shown.code == 0
    for command in COMMANDS:
        assert f"│ {command} " in shown.out
    for code in ("0: ", "1: ", "3: ", "130: "):
        assert code in shown.out


def _functions() -> dict[str, Any]:
    """Function of each command by the words that call it; a group has several."""
    found: dict[str, Any] = {}
    for command in COMMANDS:
        made = getattr(import_module(f"hueflight.cli.{command}"), command)
        if isinstance(made, App):
            names = [name for name in made if not name.startswith("-")]
            found |= {f"{command} {name}": made[name].default_command for name in names}
        else:
            found[command] = made
    return found


@pytest.mark.parametrize("command", COMMANDS)
def test_a_summary_is_the_first_line_of_the_commands_docstring(command: str) -> None:
    function = getattr(import_module(f"hueflight.cli.{command}"), command)
    documented = function.help if isinstance(function, App) else inspect.getdoc(function)
    assert documented.splitlines()[0] == COMMANDS[command]


@pytest.mark.parametrize("command", _functions())
def test_help_of_every_option_is_a_sentence_of_its_own(command: str, run) -> None:
    function = _functions()[command]
    documented = inspect.getdoc(function) or ""
    parameters = documented.partition("Parameters\n---")[2].partition("\nReturns\n")[0]
    texts = ["".join(f" {line.strip()}" for line in block) for block in _descriptions(parameters)]
    assert len(texts) == len(inspect.signature(function).parameters)
    for text in texts:
        assert text[1].isupper(), text
        assert text.endswith("."), text
        # a whole sentence names what it is about: it can't begin with what stands before it
        assert not text.startswith((" Of ", " That ", " Its ", " The same", " Likewise")), text
    shown = run(*command.split(), "--help")
    assert shown.code == 0
    assert "--help" not in shown.err


def _descriptions(parameters: str) -> list[list[str]]:
    blocks: list[list[str]] = []
    for line in parameters.splitlines():
        if " : " in line and not line.startswith(" "):
            blocks.append([])
        elif line.startswith("    ") and blocks:
            blocks[-1].append(line)
    return blocks


def test_help_lists_the_choices_there_are(run) -> None:
    from hueflight.export import FORMATS
    from hueflight.reconstruction.entry_point import METHODS
    from hueflight.simulator import SCENES

    for command, choices in (
        ("reconstruct", METHODS), ("serve", METHODS), ("serve", SCENES), ("capture", SCENES),
        ("simulate", SCENES), ("export", FORMATS), ("simulate", ("paper", "fine")),
        ("capture", ("reference", "bands", "dark", "flat")),
    ):  # fmt: skip
        shown = run(command, "--help").out
        for choice in choices:
            assert choice in shown, (command, choice)


def test_commands_do_not_import_the_application() -> None:
    """The application names the commands; they must not name it."""
    folder = Path(inspect.getfile(main)).parent
    for path in folder.glob("*.py"):
        if path.stem in ("app", "__init__"):
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom):
                assert node.module not in ("hueflight.cli", "hueflight.cli.app"), path.name


def test_brackets_in_names_are_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    show("Image lab[/run].zarr", {"preview": "lab[/run].png"}, json_wanted=False)
    shown = capsys.readouterr().out
    assert "lab[/run].zarr" in shown
    assert "lab[/run].png" in shown


def test_brackets_in_a_path_reach_table_and_message(bench: Path, run) -> None:
    (bench / "lab[").mkdir()
    words = ("--instrument", "bench.toml", "--frames", "5", "-o", "lab[/run].npz")
    done = run("simulate", "plane", *words)
    assert done.code == 0, done.err
    assert "lab[/run].npz" in done.out
    refused = run("simulate", "plane", *words)
    assert refused.code == 1
    assert "lab[/run].npz" in refused.err


def test_a_simulation_with_effects_says_which_and_writes_their_truth(bench: Path, run) -> None:
    words = ("--instrument", "bench.toml", "--frames", "20", "--json")
    effects = ("--rays", "2", "--pane-share", "0.3", "--delay-drift-ps=-50", "--new-hot-share=0.1")
    done = run("simulate", "fig7", *words, *effects, "-o", "a.mcap", "--truth", "truth.npz")
    assert done.code == 0, done.err
    shown = "pane_share = 0.3, delay_drift_ps = -50.0, new_hot_share = 0.1"
    assert done.json["effects"] == shown
    assert run("info", "a.mcap", "--json").json["metadata"]["effects"] == shown
    with np.load(bench / "truth.npz") as truth:
        assert truth["depth"].shape == (12, 10)
        assert truth["shares"].sum(axis=0) == pytest.approx(1)
        assert truth["turned_hot"].sum() == 12
        assert truth["delay_drift_ps"].tolist() == [-50, -50, -50]
    moving = ("--motion", "0.01", "0", "-0.2", "-o", "moving.npz", "--truth", "moving_truth.npz")
    assert run("simulate", "fig7", *words, *moving).json["motion"] == "0.01 m, 0 m, -0.2 m"
    with np.load(bench / "moving_truth.npz") as truth:
        assert np.nanmax(truth["depths"]) - np.nanmin(truth["depths"]) > 0.2
    still = run("simulate", "--capture", "dark", *words, *moving[:4], "-o", "d.npz")
    assert still.code == 1
    assert "--motion" in still.err
    plain = run("simulate", "fig7", *words, "-o", "plain.mcap")
    assert "effects" not in plain.json
    assert "effects" not in run("info", "plain.mcap", "--json").json["metadata"]
    for kind in ("reference", "bands", "dark"):
        name = f"{kind}.npz"
        out = ("-o", f"capture_{name}", "--truth", f"truth_{name}")
        assert run("simulate", "--capture", kind, *words, "--reflection", "0.5", *out).code == 0
        with np.load(bench / f"truth_{name}") as truth:
            assert bool(truth["stray_photons"].any()) == (kind != "dark")
    # nothing was replaced, and nothing written
    again = run("simulate", "fig7", *words, "-o", "b.mcap", "--truth", "truth.npz")
    assert again.code == 1
    assert "truth.npz" in again.err
    assert not (bench / "b.mcap").exists()


def recorded(run, name: str, frames: int = 300) -> None:
    words = ("--instrument", "bench.toml", "--frames", str(frames), "-o", name, "--json")
    assert run("simulate", "plane", "--distance", "0.8", *words).code == 0


def calibrated(run) -> None:
    words = ("--instrument", "bench.toml", "--frames", "3000", "-o", "reference.npz")
    assert run("simulate", "--capture", "reference", *words).code == 0
    assert run("calibrate", "reference.npz", "-d", "0.4", "-o", "cal.zarr").code == 0


def test_what_a_recording_lost_is_said_with_its_image(bench: Path, run) -> None:
    calibrated(run)
    recorded(run, "scene.mcap")
    whole = run("reconstruct", "scene.mcap", "-c", "cal.zarr", "-o", "whole.zarr", "--json")
    assert not [key for key in whole.json if key.startswith("lost_")]
    data = bytearray((bench / "scene.mcap").read_bytes())
    data[len(data) // 2] ^= 0x10  # in the middle of a file there are packets
    (bench / "scene.mcap").write_bytes(data)
    hurt = run("reconstruct", "scene.mcap", "-c", "cal.zarr", "-o", "hurt.zarr", "--json")
    assert hurt.json["lost_damaged"] == 1
    assert "damaged 1" in xr.open_zarr(bench / "hurt.zarr").attrs["capture_losses"]
    recovery = run("recover", "scene.mcap", "--json")
    assert recovery.code == 3
    assert recovery.json["outcome"] == "lossy"
    assert recovery.json["frames"] == 299


def test_an_unknown_number_of_exposures_is_said(bench: Path, run) -> None:
    (bench / "bench.toml").write_text(TOML.replace("no photon", "bin"))
    calibrated(run)
    words = ("calibrate", "reference.npz", "-d", "0.4", "-o", "again.zarr", "--overwrite", "--json")
    assert run(*words).json["exposures"].startswith("unknown")
    assert "exposures" not in run(*words, "--frames", "3000").json
    made = run("reconstruct", "reference.npz", "-c", "cal.zarr", "-o", "image.zarr", "--json")
    assert made.code == 0, made.err
    for said in (made, run("info", "image.zarr", "--json")):
        assert said.json["exposures"].startswith("unknown for the reference")


def test_a_batch_goes_on_after_a_failure_and_says_so(bench: Path, run) -> None:
    calibrated(run)
    for name in ("a.mcap", "b.mcap"):
        recorded(run, name, frames=100)
    (bench / "c.mcap").write_bytes(b"no recording")
    words = ("reconstruct", "a.mcap", "b.mcap", "c.mcap", "-c", "cal.zarr", "-o", "all")
    mixed = run(*words, "--workers", "1", "--json")
    assert mixed.code == 1
    assert (mixed.json["done"], mixed.json["failed"]) == (2, 1)
    assert {path.name for path in (bench / "all").glob("*.zarr")} >= {"a.zarr", "b.zarr"}
    again = run(*words, "--workers", "1", "--json")
    assert (again.json["done"], again.json["kept"]) == (0, 2)


def test_an_image_is_exported_by_its_ending(bench: Path, run) -> None:
    calibrated(run)
    recorded(run, "scene.mcap")
    assert run("reconstruct", "scene.mcap", "-c", "cal.zarr", "-o", "scene.zarr").code == 0
    assert run("export", "scene.zarr", "cloud.ply", "--json").json == {"files": ["cloud.ply"]}
    assert (bench / "cloud.ply").read_bytes().startswith(b"ply\n")
    refused = run("export", "scene.zarr", "cloud.xyz")
    assert refused.code == 1
    assert "cloud.xyz" in refused.err


def test_an_existing_picture_is_not_replaced_unasked(bench: Path, run) -> None:
    """`reconstruct -o p.zarr` writes p.png too: both are looked for before anything is read."""
    (bench / "scene.png").write_bytes(b"somebody's picture")
    words = ("reconstruct", "no-such.mcap", "-c", "no-such.zarr", "-o", "scene.zarr")
    refused = run(*words)
    assert refused.code == 1
    assert "'scene.png' exists already" in refused.err
    assert "--overwrite" in refused.err
    calibrated(run)
    recorded(run, "scene.mcap", frames=50)
    words = ("reconstruct", "scene.mcap", "-c", "cal.zarr", "-o", "scene.zarr")
    assert run(*words).code == 1
    assert (bench / "scene.png").read_bytes() == b"somebody's picture"
    assert not (bench / "scene.zarr").exists()
    assert run(*words, "--no-preview").code == 0
    assert (bench / "scene.png").read_bytes() == b"somebody's picture"
    assert run(*words, "--overwrite").code == 0
    assert (bench / "scene.png").read_bytes().startswith(b"\x89PNG")


def test_an_existing_result_is_found_before_anything_is_read(bench: Path, run) -> None:
    (bench / "there.zarr").mkdir()
    for words in (
        ("reconstruct", "no-such.mcap", "-c", "no-such.zarr", "-o", "there.zarr"),
        ("calibrate", "no-such.mcap", "-d", "0.4", "-o", "there.zarr"),
    ):
        refused = run(*words)
        assert refused.code == 1
        assert "'there.zarr' exists already" in refused.err


def test_a_report_does_not_replace_a_foreign_page(bench: Path, run) -> None:
    (bench / "index.html").write_text("my page")
    refused = run("demo", "--out", ".", "--frames", "100")
    assert refused.code == 1
    assert "index.html' exists already" in refused.err
    assert (bench / "index.html").read_text() == "my page"


def test_a_capture_does_not_replace_a_file_beside_it(bench: Path, run) -> None:
    (bench / "scene.json").write_text("{}")
    words = ("--simulate", "--instrument", "bench.toml", "--frames", "5", "-o", "scene.mcap")
    refused = run("capture", *words)
    assert refused.code == 1
    assert "'scene.json' exists already" in refused.err
    assert (bench / "scene.json").read_text() == "{}"
    assert not (bench / "scene.mcap").exists()


def test_a_batch_does_not_replace_images_of_other_captures(bench: Path, run) -> None:
    calibrated(run)
    for folder in ("run1", "run2"):
        (bench / folder).mkdir()
        recorded(run, f"{folder}/scan.mcap", frames=50)
    words = ("-c", "cal.zarr", "-o", "all", "--workers", "1", "--json")
    assert run("reconstruct", "run1/scan.mcap", *words).json["done"] == 1
    refused = run("reconstruct", "run2/scan.mcap", *words)
    assert refused.code == 1
    assert "run1/scan.mcap" in refused.err
    assert run("reconstruct", "run1/scan.mcap", *words).json["kept"] == 1
    assert run("reconstruct", "run2/scan.mcap", *words, "--overwrite").json["done"] == 1
    # the same capture in another way is meant to take its own image's place
    again = run("reconstruct", "run2/scan.mcap", *words, "--range-correction")
    assert again.json["done"] == 1
    assert again.json["outcomes"][0]["summary"]["pixels"] == 120


@pytest.fixture
def measured(bench: Path, run) -> Path:
    """The folder with a calibration, a scene, and the scene's counts in other arrangements."""
    calibrated(run)
    words = ("--distance", "0.8", "--instrument", "bench.toml", "--frames", "600")
    assert run("simulate", "plane", *words, "-o", "scene.npz").code == 0
    counts = np.load(bench / "scene.npz")["histogram"]
    np.savez(bench / "turned.npz", first=np.zeros(3), second=np.moveaxis(counts, -1, 0))
    return bench


def image_of(folder: Path, run, *words: str, out: str = "image.zarr") -> xr.Dataset:
    done = run("reconstruct", *words, "-c", "cal.zarr", "-o", out, "--overwrite", "--json")
    assert done.code == 0, done.err
    return read_image(folder / out)


def test_array_and_axes_are_named_on_the_command_line(measured: Path, run) -> None:
    plain = image_of(measured, run, "scene.npz")
    named = ("turned.npz", "--dataset", "second", "--axes", "code,row,col")
    xr.testing.assert_equal(image_of(measured, run, *named), plain)
    batch = run("reconstruct", *named, "-c", "cal.zarr", "-o", "all", "--workers", "1", "--json")
    assert batch.json["done"] == 1, batch.json
    xr.testing.assert_equal(read_image(measured / "all/turned.zarr"), plain)
    # other axes make another image: it must not be taken for the one that is there
    wrong = (*named[:-1], "code,col,row")
    batch = run("reconstruct", *wrong, "-c", "cal.zarr", "-o", "all", "--workers", "1", "--json")
    assert batch.json["failed"] == 1
    for option in ("--dataset", "--axes"):
        left_out = [word for pair in zip(named[1::2], named[2::2], strict=True)
                    if pair[0] != option for word in pair]  # fmt: skip
        refused = run("reconstruct", named[0], *left_out, "-c", "cal.zarr", "-o", "none.zarr")
        assert refused.code == 1
        assert option in refused.err
    recorded(run, "scene.mcap", frames=50)
    for option in (("--dataset", "a"), ("--axes", "col,row,code"), ("--channel", "1")):
        refused = run("reconstruct", "scene.mcap", *option, "-c", "cal.zarr", "-o", "none.zarr")
        assert refused.code == 1
        assert option[0] in refused.err


def test_calibration_takes_arrays_axes_and_frames(bench: Path, run) -> None:
    for kind in ("reference", "bands"):
        words = ("--capture", kind, "--instrument", "bench.toml", "--frames", "3000")
        assert run("simulate", *words, "-o", f"{kind}.npz").code == 0
        counts = np.load(bench / f"{kind}.npz")["histogram"]
        np.savez(bench / f"{kind}-turned.npz", a=np.zeros(3), counts=np.swapaxes(counts, -1, -3))
    plain = ("reference.npz", "--bands", "bands.npz", "-d", "0.4", "--instrument", "bench.toml")
    turned = [word.replace(".npz", "-turned.npz") for word in plain]
    options = ("--dataset", "counts", "--axes", "code,col,row")
    for words, out in ((plain, "plain.zarr"), ((*turned, *options), "turned.zarr")):
        done = run("calibrate", *words, "-o", out)
        assert done.code == 0, done.err
    refused = run("calibrate", *turned, *options[:2], "--axes", "code,row,col", "-o", "no.zarr")
    assert refused.code == 1
    one, other = (Calibration.load(bench / name) for name in ("plain.zarr", "turned.zarr"))
    np.testing.assert_array_equal(one.gain, other.gain)
    np.testing.assert_array_equal(one.templates.coefficients, other.templates.coefficients)


def test_what_is_reconstructed_is_chosen_on_the_command_line(measured: Path, run) -> None:
    calibration = Calibration.load(measured / "cal.zarr")
    counts, _ = read_counts(measured / "scene.npz")
    expected = reconstruct(
        counts, calibration, depth_range=(0.5, 1.1), frames=700, bands=["blue", 0],
        region=np.s_[2:8, :4],
    )  # fmt: skip
    options = (
        "--depth-range", "0.5", "1.1", "--frames", "700", "--bands", "blue,0",
        "--region", "2:8,:4", "--threads", "2",
    )  # fmt: skip
    image = image_of(measured, run, "scene.npz", *options)
    assert list(image["band_name"].values) == ["blue", "red"]
    for name, values in expected.data_vars.items():
        np.testing.assert_array_equal(image[name], values, err_msg=str(name))
    batch = run("reconstruct", "scene.npz", *options, "-c", "cal.zarr", "-o", "all", "--json")
    assert batch.json["done"] == 1
    # the number of threads makes no other image
    batch = run("reconstruct", "scene.npz", *options[:-2], "-c", "cal.zarr", "-o", "all", "--json")
    assert batch.json["kept"] == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--region", "3"], "--region 3: give rows and columns"),
        (["--region", "a:b,c:d"], "--region a:b,c:d: give rows and columns"),
        (["--threads", "0"], "--threads 0: at least one"),
        (["--bands", "green,amber"], "no band 'amber'; choose from red, green, blue"),
        (["--depth-range", "2", "1"], "give the nearest and the farthest"),
        (["-o", "image.ply"], "--out image.ply: images are written as NAME.zarr or NAME.nc"),
    ],
)
def test_wrong_choices_are_explained(measured: Path, run, words: list[str], message: str) -> None:
    out = [] if "-o" in words else ["-o", "image.zarr"]
    refused = run("reconstruct", "scene.npz", "-c", "cal.zarr", *out, *words)
    assert refused.code == 1
    assert message in refused.err
    assert not (measured / "image.zarr").exists()


def test_an_image_is_written_as_netcdf(measured: Path, run) -> None:
    stored = image_of(measured, run, "scene.npz")
    for name in ("image.nc", "upper.NC"):
        found = image_of(measured, run, "scene.npz", out=name)
        assert "written by hueflight" in found.attrs.pop("history")
        xr.testing.assert_identical(found, stored)


def test_endings_in_upper_case(measured: Path, run) -> None:
    recorded(run, "SCENE.MCAP", frames=50)
    (measured / "scene.npz").rename(measured / "SCENE.NPZ")
    for name in ("SCENE.MCAP", "SCENE.NPZ"):
        image_of(measured, run, name, out="IMAGE.ZARR")
    assert run("info", "SCENE.MCAP").code == 0
    assert run("export", "IMAGE.ZARR", "CLOUD.PLY").code == 0
    words = ("--instrument", "bench.toml", "--frames", "5", "-o", "B.NPZ")
    assert run("simulate", "plane", *words).code == 0
    assert job.capture_files(measured / "SCENE.MCAP") == [measured / "SCENE.MCAP"]


def test_an_image_without_its_preview_is_a_success(
    measured: Path, run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    done = run("reconstruct", "scene.npz", "-c", "cal.zarr", "-o", "image.zarr")
    assert done.code == 0
    assert len(done.err.splitlines()) == 1
    assert "no preview is drawn" in done.err
    assert "matplotlib" in done.err
    assert not (measured / "image.png").exists()
    assert read_image(measured / "image.zarr")["depth"].size == 120


def test_the_pattern_of_the_light_is_divided_out(bench: Path, run) -> None:
    (bench / "bench.toml").write_text(TOML.replace("rows = 12", "rows = 16"))
    calibrated(run)
    words = ("--distance", "0.8", "--instrument", "bench.toml", "--frames", "20000")
    assert run("simulate", "plane", *words, "-o", "board.npz").code == 0
    board = image_of(bench, run, "board.npz", out="board.zarr")
    done = run("export", "board.zarr", "even.nc", "--flat-field", "board.zarr")
    assert done.code == 0, done.err
    even = read_image(bench / "even.nc")
    expected = flatten(board, illumination_pattern(board))
    xr.testing.assert_allclose(even["reflectance"], expected["reflectance"])
    assert even["reflectance"].attrs["flat_field"] == "illumination pattern of each band"
    refused = run("export", "even.nc", "again.nc", "--flat-field", "board.zarr")
    assert "are flattened already" in refused.err


def test_a_picture_of_one_band(measured: Path, run) -> None:
    image_of(measured, run, "scene.npz")
    for band in ("green", "1", "532nm"):
        words = ("--variable", "reflectance", "--band", band, "--limits", "0", "1", "--overwrite")
        assert run("export", "image.zarr", f"{band}.png", *words).code == 0
    for same in ("1", "532nm"):
        assert (measured / "green.png").read_bytes() == (measured / f"{same}.png").read_bytes()
    refused = run("export", "image.zarr", "x.png", "--variable", "reflectance", "--band", "pink")
    assert "no band 'pink'; choose from red, green, blue" in refused.err


def test_materials_are_exported(measured: Path, run) -> None:
    image_of(measured, run, "scene.npz")
    words = ("export", "image.zarr", "more.nc", "--library", "colorchecker")
    done = run(*words, "--materials", "red, blue", "--index", "525nm,630nm")
    assert done.code == 0, done.err
    more = read_image(measured / "more.nc")
    for name in ("abundance_red", "abundance_blue_std", "index_525nm_630nm_std"):
        assert more[name].dims == ("row", "col")
    for options, reason in (
        ((), "3 bands can't tell 24 materials apart"),
        (("--materials", "gold"), "material 'gold': the library has dark skin"),
        (("--materials", "red", "--index", "NDVI"), "NDVI needs a band between 760 and 900 nm"),
        (("--materials", "red", "--frames", "3"), "--frames 3: has no effect"),
    ):
        refused = run(*words, *options, "--overwrite")
        assert refused.code == 1
        assert reason in refused.err
    assert "no effect" in run("export", "image.zarr", "x.nc", "--materials", "red").err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_their_options(shell: str) -> None:
    script = application().generate_completion(shell=shell)
    for word in (*COMMANDS, "depth-range", "dataset"):
        assert word in script
