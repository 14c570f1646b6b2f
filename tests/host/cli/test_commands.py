"""The commands as a person types them: results, messages, exit codes; never a traceback."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from hueflight.cli import main

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
        (["simulate", "-o", "x.npz", "--instrument", "papper"], "no instrument 'papper'"),
        (
            ["calibrate", "foreign.npz", "-d", "0.4", "-o", "c.zarr"],
            "'foreign.npz' is not an .npz file",
        ),
        (
            ["calibrate", "text.txt", "-d", "0.4", "-o", "c.zarr"],
            "ends in '.txt': counts are read from",
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


def test_help_names_every_command(run) -> None:
    shown = run("--help")
    assert shown.code == 0
    for command in ("demo", "simulate", "info", "calibrate", "reconstruct"):
        assert command in shown.out


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
