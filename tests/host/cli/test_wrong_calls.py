# SPDX-License-Identifier: Apache-2.0
"""Every command with wrong files, wrong units, a wrong order: one sentence says what to do."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from importlib import import_module
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
import zarr

import hueflight as hf
from hueflight.cli import instrument, main
from hueflight.cli.app import COMMANDS
from hueflight.export import describe, write
from hueflight.importers.captures import write_counts
from hueflight.recording import RecordingWriter
from hueflight.simulator import simulate_packets
from support.sdt_file import write_sdt

Run = Callable[..., tuple[int, str, str]]
TOML = """
name = "camera"
[sensor]
rows = 4
cols = 5
code_bits = 6
bin_width_ns = 1.0
[timing]
period_ns = 60.0
[[bands]]
name = "red"
wavelength_nm = 640
delay_ns = 5
pulse_fwhm_ns = 4
"""
#: what libraries and Python say to programmers
TECHNICAL = re.compile(
    r"synchronously|allow_pickle|StorePath|file://|site-packages|\w+Error\b|magic=|Traceback|"
    r"could not convert|Object |\.py\b|<class|NoneType|_ARRAY_DIMENSIONS|\bUserWarning"
)
#: FILE in turn is each of the wrong files; after the call, kinds of files that are right for it
PLACES = {
    "info FILE": {"counts", "calibration", "image", "description", "recording", "store"},
    "recover FILE": {"recording"},
    "export FILE out.ply": {"image"},
    "view FILE --no-open -o out.html --instrument camera.toml": {"counts", "image", "recording"},
    "view image.zarr --capture FILE --no-open -o out.html": {"counts", "recording"},
    "reconstruct FILE -c cal.zarr -o out.zarr --no-preview": {"counts", "recording"},
    "reconstruct counts.npy -c FILE -o out.zarr --no-preview": {"calibration"},
    "calibrate FILE -d 1 -o out.zarr --instrument camera.toml": {"counts", "recording"},
    "calibrate counts.npy -d 1 -o out.zarr --instrument FILE": {"description"},
    "calibrate counts.npy -d 1 -o out.zarr --instrument camera.toml --bands FILE": set(),
    "calibrate counts.npy -d 1 -o out.zarr --instrument camera.toml --dark FILE": {
        "counts", "recording"
    },
    "check FILE counts.npy": {"calibration"},
    "check cal.zarr FILE": {"counts", "recording"},
    "simulate plane --frames 1 -o out.npz --instrument FILE": {"description"},
    "capture --simulate --frames 1 -o out.mcap --instrument FILE": {"description"},
    "instrument show FILE": {"description"},
    "instrument check FILE counts.npy -d 1": {"description"},
    "instrument check camera.toml FILE -d 1": {"counts", "recording"},
    "instrument new out.toml --from FILE --band red,640,0,2": set(),
}  # fmt: skip
KINDS = {
    "counts.npy": "counts", "counts.npz": "counts", "cal.zarr": "calibration",
    "image.zarr": "image", "camera.toml": "description", "scene.mcap": "recording",
    "other.zarr": "store",
}  # fmt: skip
#: wrong units, choices and order; a part of what must be said
WRONG = {
    "calibrate counts.npy -d 1000 -o out.zarr --instrument camera.toml": "such as 1 for 1000 mm",
    "calibrate counts.npy -d 40cm -o out.zarr --instrument camera.toml": "-d 40cm: give a number",
    "calibrate counts.npy -d -1 -o out.zarr --instrument camera.toml": "in metres, 0 or more",
    "calibrate counts.npy -d nan -o out.zarr --instrument camera.toml": "in metres, 0 or more",
    "calibrate counts.npy -d 1 -o out.zarr --instrument camera.toml --reflectance 50":
        "give 0.5 for 50 %",
    "calibrate counts.npy -d 1 -o out.zarr --instrument camera.toml --frames 0": "above 0",
    "calibrate counts.npy -d 1 -o out.zarr --instrument camera.toml --axes x,y,t":
        "name row, col and code",
    "calibrate counts.npy -d 1 -o out.zarr --instrument paper": "has shape (4, 5, 64)",
    "calibrate counts.npy -d 1 -o out.npz --instrument camera.toml": "written as NAME.zarr",
    "calibrate counts.npy -o out.zarr": "the option --distance is missing",
    "calibrate counts.npy -d": "-d needs a value",
    "check cal.zarr counts.npy --frames 50": "frames = 50",
    "check cal.zarr counts.npy -d 1000": "such as 1 for 1000 mm",
    "check counts.npy cal.zarr": "'counts.npy' is a NumPy array (.npy), not a calibration",
    "check cal.zarr counts.npy --josn": "did you mean --json?",
    "instrument check camera.toml counts.npy -d 1000": "such as 1 for 1000 mm",
    "instrument check counts.npy camera.toml -d 1": "not the description of an instrument",
    "instrument shwo paper": "did you mean show?",
    "instrument new out.toml --rows 2 --cols 2 --code-bits 6 --bin-width 1 --band red,0.64,0,2":
        "0.64",
    "instrument new out.toml --rows 2 --cols 2 --code-bits 6 --bin-width 1 --band red": "red",
    "instrument new out.toml --rows 2 --cols 2 --code-bits 6 --bin-width 50 --period 10 "
    "--band red,640,0,2": "period",
    "reconstruct counts.npy -c cal.zarr -o out.zarr --depth-range 500 1500": "depth_range",
    "reconstruct counts.npy -c cal.zarr -o out.zarr --depth-range 1":
        "takes 2 values, but 1 is given",
    "reconstruct counts.npy -c cal.zarr -o out.zarr --method jont": "choose one of joint",
    "reconstruct counts.npy -c cal.zarr -o out.zarr --background steep": '"flat", "sloped"',
    "reconstruct counts.npy -c cal.zarr -o out.tif": "written as NAME.zarr or NAME.nc",
    "reconstruct cal.zarr -c counts.npy -o out.zarr": "not a calibration",
    "reconstruct counts.npy": "the option --calibration is missing",
    "reconstruct -c cal.zarr -o out.zarr": "no captures: name at least one",
    "export out.ply image.zarr": "no image 'out.ply'",
    "export image.zarr": "OUT is missing",
    "export image.zarr out.ply more": "'more' is more than the command takes",
    "export image.zarr out.png --variable depht": "depht",
    "export image.zarr out.png --variable reflectance --band blue": "choose from red",
    "export image.zarr out -f plyy": "plyy",
    "view image.zarr -o out.txt --no-open": "a page is written as NAME.html",
    "simulate plane --frames 2 -o out": "must end in .mcap (packets) or .npz (counts)",
    "simulate plane --frames 0 -o out.npz --instrument camera.toml": "frames = 0",
    "reconstruct counts.npy -c cal.zarr -o out.zarr --threads 1.5":
        "--threads 1.5: give a whole number",
    "simulate plane --frames 1.5 -o out.npz": "--frames 1.5: give a whole number",
    "instrument new out.toml --rows 2.5": "--rows 2.5: give a whole number",
    "simulate plane -o out.npz --delay-drift-ps 1 2 3":
        "repeated before each: --delay-drift-ps 1 --delay-drift-ps 2 --delay-drift-ps 3",
    "view image.zarr --no-open -o out.html --threads 2": "image.zarr is not reconstructed here",
    "simulate plane --frames ten -o out.npz": "--frames ten: give a whole number",
    "capture --simulate --frames 1 -o out.npz": "out.npz",
    "demo --frames 5 -o out": "no option -o",
    "serve --rig foo:bar": "foo",
    "recover counts.npz": "'counts.npz' is a ZIP archive (.npz)",
    "info": "FILE is missing",
    "calibrat counts.npy": "did you mean calibrate?",
}  # fmt: skip


#: calls that read counts, and the options that say what to read or how to reconstruct it
READING = ("dataset", "axes", "channel")
PICTURE = ("frames", "depth-range", "bands", "region", "threads")
OPTIONS = {
    "calibrate counts.npy -d 1 -o out.zarr --instrument camera.toml": (*READING, "frames"),
    "check cal.zarr counts.npy": (*READING, "frames"),
    "instrument check camera.toml counts.npy -d 1": READING,
    "reconstruct counts.npy -c cal.zarr -o out.zarr --no-preview": (*READING, *PICTURE),
    "view counts.npy -c cal.zarr --no-open -o out.html": (*READING, *PICTURE),
    "view image.zarr --capture counts.npy --no-open -o out.html": READING,
    "instrument new out.toml --from scan.sdt --band red,640,0,2": ("dataset", "channel"),
}
#: of each option, a value that is right for these files, a wrong one, and what is said of that
VALUES = {
    "dataset": ("", "x", "--dataset"),
    "axes": ("row,col,code", "code,row,col", "(4, 5, 64)"),
    "channel": ("", "1", "channel"),
    "frames": ("100000", "0", "above 0"),
    "depth-range": ("0.5 1.5", "500 1500", "depth_range"),
    "bands": ("red", "blue", "red"),
    "region": ("0:2,1:4", "0:2", "--region 0:2: give rows and columns"),
    "threads": ("2", "0", "--threads 0: at least one"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a file of each kind, and with files that are not what their names say."""
    folder = tmp_path_factory.mktemp("wrong")
    (folder / "camera.toml").write_text(TOML)
    instrument = hf.Instrument.load(folder / "camera.toml")
    time = np.arange(64)
    shape = np.where(time < 60, 200 * np.exp(-(((time - 12) / 2) ** 2)) + 1, 0)
    counts = np.random.default_rng(1).poisson(shape, (4, 5, 64)).astype(np.uint16)
    np.save(folder / "counts.npy", counts)
    write_counts(folder / "counts.npz", counts, instrument)
    calibration = hf.calibrate(counts, instrument, distance=1.0)
    calibration.save(folder / "cal.zarr")
    image = describe(hf.reconstruct(counts, calibration, method="paper"), calibration)
    write(image, folder / "image.zarr")
    frames = instrument.replace(sensor=hf.Instrument.load("paper").sensor)
    with RecordingWriter(folder / "scene.mcap", frames) as record:
        for packet in simulate_packets("dark", frames, frames=1):
            record.write(packet)
    zarr.open_group(folder / "other.zarr", mode="w", zarr_format=2)
    (folder / "folder").mkdir()
    for name in ("empty.npy", "empty.mcap", "empty.toml"):
        (folder / name).touch()
    for ending in ("txt", "mcap", "npy", "npz", "h5", "mat", "ptu", "sdt", "nc", "zarr", "toml"):
        (folder / f"text.{ending}").write_text("hello\n")
    (folder / "words.csv").write_text("a,b\n1,x\n")
    (folder / "other.json").write_text('{"a": 1}')
    (folder / "other.toml").write_text("x = 1\n")
    (folder / "number.toml").write_text(TOML.replace("rows = 4", 'rows = "4"'))
    (folder / "short.npy").write_bytes((folder / "counts.npy").read_bytes()[:500])
    (folder / "short.npz").write_bytes((folder / "counts.npz").read_bytes()[:500])
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    return folder


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Function that runs a command in that folder: exit code, standard output and error."""
    monkeypatch.chdir(folder)

    def run(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            main(words)
        captured = capsys.readouterr()
        return int(stop.value.code or 0), captured.out, captured.err

    return run


def require_one_sentence(code: int, out: str, err: str) -> str:
    lines = [line for line in err.splitlines() if line.strip()]
    assert code == 1, (code, out, err)
    assert len(lines) == 1, err
    assert lines[0].startswith("error: ")
    assert not TECHNICAL.search(lines[0]), lines[0]
    assert out == ""
    return lines[0]


@pytest.mark.parametrize("call", PLACES)
def test_a_wrong_file_is_named_and_recognized(folder: Path, run: Run, call: str) -> None:
    wrong = [path.name for path in folder.iterdir() if not path.name.startswith("out")]
    wrong += ["missing.npy", "missing.zarr", "missing.mcap", "missing.toml"]
    for name in sorted(wrong):
        if KINDS.get(name) in PLACES[call]:
            continue
        if name == "counts.npz" and "--capture" in call:
            continue
        words = [name if word == "FILE" else word for word in call.split()]
        message = require_one_sentence(*run(*words))
        assert name in message
        assert not list(folder.glob("out*")), call


@pytest.mark.parametrize("call", WRONG)
def test_a_wrong_call_says_what_to_do(folder: Path, run: Run, call: str) -> None:
    before = sorted(path.name for path in folder.iterdir())
    message = require_one_sentence(*run(*call.split()))
    assert WRONG[call] in message
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(
    ("call", "option"), [(call, option) for call in OPTIONS for option in OPTIONS[call]]
)
def test_options_reach_every_command_that_has_them(
    folder: Path, run: Run, call: str, option: str
) -> None:
    right, wrong, said = VALUES[option]
    if "scan.sdt" in call:
        pytest.importorskip("sdtfile")
        write_sdt(folder / "scan.sdt", [np.load(folder / "counts.npy")], 1e-9)
        right, said = "0", {"dataset": "no data block 'x'", "channel": "in channel 1"}[option]
    message = require_one_sentence(*run(*call.split(), f"--{option}", *wrong.split()))
    assert said in message
    try:
        if right:
            code, _, err = run(*call.split(), f"--{option}", *right.split())
            assert code in (0, 4) or ("instrument check" in call and code == 1), err
            assert "error" not in err
    finally:
        for path in (*folder.glob("out*"), *folder.glob("scan.*")):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def test_no_other_command_has_these_options() -> None:
    """And those that have them are all in the table; export and simulate have their own frames."""
    functions = {name: getattr(import_module(f"hueflight.cli.{name}"), name) for name in COMMANDS}
    functions |= {"instrument check": instrument.check, "instrument new": instrument.new}
    del functions["instrument"]
    listed: dict[str, set[str]] = {}
    for call, options in OPTIONS.items():
        words = call.split()
        name = " ".join(words[:2]) if words[0] == "instrument" else words[0]
        listed.setdefault(name, set()).update(options)
    for name, function in functions.items():
        has = {word.replace("_", "-") for word in signature(function).parameters} & set(VALUES)
        own = {"frames"} if name in ("export", "simulate", "capture", "demo") else set()
        if name == "calibrate":
            own = {"bands"}  # a capture of each band
        assert has - own == listed.get(name, set()), name


def test_a_taken_name_has_the_same_message_everywhere(folder: Path, run: Run) -> None:
    """Before anything is read."""
    calls = (
        "calibrate no.npy -d 1 -o taken.zarr", "reconstruct no.npy -c no.zarr -o taken.zarr",
        "check no.zarr no.npy --page taken.html", "view no.zarr -o taken.html --no-open",
        "simulate plane --instrument camera.toml --frames 1 -o taken.npz",
        "export image.zarr taken.ply", "instrument new taken.toml --band red,640,0,2",
        "capture --simulate --frames 1 -o taken.mcap",
    )  # fmt: skip
    for call in calls:
        taken = folder / next(word for word in call.split() if word.startswith("taken"))
        taken.mkdir() if taken.suffix == ".zarr" else taken.touch()
        try:
            message = require_one_sentence(*run(*call.split()))
            assert f"'{taken.name}' exists already: choose another name" in message
        finally:
            shutil.rmtree(taken) if taken.is_dir() else taken.unlink()
