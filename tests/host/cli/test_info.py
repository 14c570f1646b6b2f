# SPDX-License-Identifier: Apache-2.0
"""`hueflight info` on everything that is read or written, whole and damaged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import ptufile
import pytest
import zarr
from numpy.typing import NDArray
from scipy.io import savemat

import hueflight as hf
from hueflight import simulator
from hueflight.cli import main
from hueflight.errors import FileFormatError
from hueflight.export import describe, write, write_histogram
from hueflight.recording import RecordingWriter

Info = Callable[..., tuple[int, dict, str]]
KINDS = {
    "scene.mcap": "recording of packets",
    "counts.npz": "counts in NumPy arrays",
    "counts.npy": "counts in a NumPy array",
    "counts.zarr": "counts in a Zarr store",
    "counts.h5": "arrays in HDF5",
    "cal.zarr": "calibration",
    "image.zarr": "image",
    "image.nc": "image",
    "camera.toml": "instrument description",
    "counts.ptu": "PicoQuant PTU file",
    "counts.mat": "MATLAB file",
    "counts73.mat": "MATLAB file",
    "counts.csv": "table of numbers",
    "log.json": "log of a time-of-flight module",
}
#: formats without checksums: damage may go unnoticed, and the result says so
WITHOUT_CHECKSUMS = (
    "counts.npy", "counts.zarr", "counts.h5", "image.nc", "counts.ptu", "counts.mat",
    "counts73.mat", "counts.csv", "log.json",
)  # fmt: skip
#: kinds that have no description apart from their content
READ_AT_ONCE = ("camera.toml", "counts.csv", "log.json")
TOML = """
name = "camera"
[sensor]
rows = 3
cols = 4
code_bits = 6
bin_width_ns = 1.0
[timing]
period_ns = 60.0
[[bands]]
name = "red"
wavelength_nm = 640
delay_ns = 5
"""


@pytest.fixture(scope="module")
def files(
    tmp_path_factory: pytest.TempPathFactory,
    small: Callable[..., hf.Instrument],
    draw: Callable[..., NDArray[np.uint32]],
) -> Path:
    """A folder with one file of each kind."""
    folder = tmp_path_factory.mktemp("info")
    instrument = small(rows=4, cols=3)
    with RecordingWriter(folder / "scene.mcap", instrument, metadata={"note": "test"}) as writer:
        for packet in simulator.simulate_packets("reference", instrument, frames=40):
            writer.write(packet)
    counts = draw(instrument, depth=0.4)
    hf.write_counts(folder / "counts.npz", counts, instrument)
    np.save(folder / "counts.npy", counts)
    store = zarr.open_array(
        folder / "counts.zarr", mode="w", shape=counts.shape, dtype=counts.dtype, zarr_format=2
    )
    store[...] = counts
    store.attrs["instrument"] = instrument.to_json()
    write_histogram(counts, instrument, folder / "counts.h5")
    calibration = hf.calibrate(counts, instrument, distance=0.4)
    calibration.save(folder / "cal.zarr")
    image = describe(hf.reconstruct(draw(instrument, seed=1), calibration), calibration)
    for name in ("image.zarr", "image.nc"):
        write(image, folder / name)
    (folder / "camera.toml").write_text(TOML)
    savemat(folder / "counts.mat", {"counts": counts, "bin_width_ns": 0.5})
    with h5py.File(folder / "counts73.mat", "w", userblock_size=512) as file:
        file["counts"] = counts.T
    np.savetxt(folder / "counts.csv", counts.reshape(12, -1), "%d", delimiter=",")
    log = [{"hists": [[1, 2, 3]] * 4, "reference_hist": [5, 6, 7]}] * 2
    (folder / "log.json").write_text(json.dumps(log))
    photons = np.random.default_rng(1).poisson(0.8, (4, 3, 125)).astype(np.uint16)
    ptufile.imwrite(
        folder / "counts.ptu", photons, global_resolution=50e-9, tcspc_resolution=0.4e-9
    )
    return folder


@pytest.fixture
def info(capsys: pytest.CaptureFixture[str]) -> Info:
    """Function that runs the command and returns exit code, JSON object and standard error."""

    def run(path: Path, *options: str) -> tuple[int, dict, str]:
        with pytest.raises(SystemExit) as stop:
            main(["info", str(path), "--json", *options])
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        code = stop.value.code
        return int(code or 0), json.loads(captured.out or "{}"), captured.err  # type: ignore[arg-type]

    return run


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_of_file_is_described_and_checked(files: Path, info: Info, name: str) -> None:
    code, found, _ = info(files / name)
    assert code == 0
    assert found["kind"] == KINDS[name]
    if name in READ_AT_ONCE:
        assert found["whole"] is True
    else:
        assert found["whole"] is None
        assert "--check" in found["evidence"]
    code, checked, _ = info(files / name, "--check")
    assert code == 0
    assert checked["whole"] is True
    assert ("no checksums" in checked["evidence"]) == (name in WITHOUT_CHECKSUMS)
    shared = found.keys() - {"whole", "evidence"}
    assert {key: checked[key] for key in shared} == {key: found[key] for key in shared}


def test_what_is_in_the_files(files: Path, info: Info, small: Callable[..., hf.Instrument]) -> None:
    instrument = small(rows=4, cols=3)
    _, recording, _ = info(files / "scene.mcap")
    assert (recording["frames"], recording["metadata"]) == (40, {"note": "test"})
    assert recording["ended"] is True
    assert "complete" not in recording
    for name in ("counts.npz", "counts.zarr", "cal.zarr"):
        _, found, _ = info(files / name)
        assert (found["rows"], found["cols"], found["codes"]) == (4, 3, 512)
        assert found["fingerprint"] == instrument.fingerprint()
        assert len(found["bands"]) == len(instrument.bands)
    assert info(files / "counts.npz")[1]["arrays"] == {"histogram": "4 × 3 × 512 uint32"}
    assert info(files / "counts.npy")[1]["arrays"] == {"(only one)": "4 × 3 × 512 uint32"}
    assert info(files / "cal.zarr")[1]["distance_m"] == 0.4
    for name in ("image.zarr", "image.nc"):
        _, found, _ = info(files / name)
        assert (found["row"], found["col"], found["band"]) == (4, 3, len(instrument.bands))
        assert found["method"] == "joint"
        assert "depth_std" in found["variables"]
        assert found["bands"] == [band.name for band in instrument.bands]
    _, toml, _ = info(files / "camera.toml")
    assert (toml["instrument"], toml["bands"]) == ("camera", ["red 640 nm"])
    _, ptu, _ = info(files / "counts.ptu", "--check")
    assert ptu["mode"] == "T3"
    assert ptu["bin_width_ns"] == pytest.approx(0.4)
    assert ptu["channels_with_photons"] == [0]


@pytest.mark.parametrize("place", [0.3, 0.5, 0.7])
def test_one_changed_byte_of_a_recording_is_found(
    files: Path, tmp_path: Path, info: Info, place: float
) -> None:
    data = bytearray((files / "scene.mcap").read_bytes())
    data[int(len(data) * place)] ^= 0x10
    (tmp_path / "scene.mcap").write_bytes(data)
    code, found, _ = info(tmp_path / "scene.mcap")
    assert code == 0
    assert found["whole"] is None  # it does not call whole what it did not read
    code, found, _ = info(tmp_path / "scene.mcap", "--check")
    assert code == 3
    assert found["whole"] is False
    assert "hueflight recover" in found["evidence"]


@pytest.mark.parametrize("name", ["counts.npz", "cal.zarr", "image.zarr"])
def test_one_changed_byte_is_found_by_the_checksum(
    files: Path, tmp_path: Path, info: Info, name: str
) -> None:
    copy = tmp_path / name
    if (files / name).is_dir():
        shutil.copytree(files / name, copy)
        target = max((path for path in copy.rglob("*") if path.name[0].isdigit()),
                     key=lambda path: path.stat().st_size)  # fmt: skip
    else:
        target = Path(shutil.copy(files / name, copy))
    data = bytearray(target.read_bytes())
    data[len(data) // 2] ^= 1
    target.write_bytes(data)
    assert info(copy)[0] == 0
    code, found, _ = info(copy, "--check")
    assert code == 3
    assert found["whole"] is False


@pytest.mark.parametrize(
    "name", ["scene.mcap", "counts.npz", "counts.npy", "counts.h5", "image.nc"]
)
def test_files_cut_short_are_not_described(
    files: Path, tmp_path: Path, info: Info, name: str
) -> None:
    whole = (files / name).read_bytes()
    for keep in (0, len(whole) // 2):
        (tmp_path / name).write_bytes(whole[:keep])
        code, found, message = info(tmp_path / name)
        assert code == 1
        assert not found
        assert message.startswith("error: ")
        assert name in message


def test_a_ptu_file_that_was_cut_short_is_called_so_without_a_check(
    files: Path, tmp_path: Path, info: Info
) -> None:
    whole = (files / "counts.ptu").read_bytes()
    (tmp_path / "a.ptu").write_bytes(whole[:-40])
    for options in ([], ["--check"]):
        code, found, _ = info(tmp_path / "a.ptu", *options)
        assert code == 3
        assert "cut short" in found["evidence"]


def test_a_damaged_array_in_hdf5_is_found_where_it_has_a_checksum(
    tmp_path: Path, info: Info
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("a", data=np.arange(4096), chunks=(4096,), fletcher32=True)
        at = data.id.get_chunk_info(0).byte_offset
    raw = bytearray((tmp_path / "a.h5").read_bytes())
    raw[at + 100] ^= 1
    (tmp_path / "a.h5").write_bytes(raw)
    assert info(tmp_path / "a.h5")[0] == 0
    assert info(tmp_path / "a.h5", "--check")[0] == 3


def test_unknown_and_missing_files(tmp_path: Path, info: Info) -> None:
    (tmp_path / "a.txt").write_text("text")
    code, _, message = info(tmp_path / "a.txt")
    assert code == 1
    assert ".mcap, .npz" in message
    for name in KINDS:
        code, _, message = info(tmp_path / f"none-{name}")
        assert code == 1
        assert f"none-{name}" in message


def test_the_table_says_that_contents_were_not_checked(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for options, words in (([], "not checked"), (["--check"], "whole:")):
        with pytest.raises(SystemExit):
            main(["info", str(files / "scene.mcap"), *options])
        shown = " ".join(capsys.readouterr().out.split())
        assert words in shown
        assert "complete" not in shown


def test_files_of_other_programs_say_what_they_hold(files: Path, info: Info) -> None:
    shown = info(files / "counts.mat")[1]["arrays"]
    same = info(files / "counts73.mat")[1]["arrays"]
    assert shown["counts"].startswith("4 × 3 × ")
    assert same["counts"].split(" uint")[0] == shown["counts"].split(" uint")[0]
    table = info(files / "counts.csv")[1]
    assert (table["lines"], table["sum_of_numbers"]) == (
        12, np.loadtxt(files / "counts.csv", delimiter=",").sum()
    )  # fmt: skip
    log = info(files / "log.json")[1]
    assert (log["captures"], log["zones_and_bins"], log["reference"]) == (2, "4 × 3", True)


def test_damage_in_files_of_other_programs_is_found(
    files: Path, info: Info, tmp_path: Path
) -> None:
    whole = (files / "counts.mat").read_bytes()
    (tmp_path / "cut.mat").write_bytes(whole[: len(whole) // 2])
    code, found, message = info(tmp_path / "cut.mat", "--check")
    assert code in (1, 3)
    assert message or found["whole"] is False
    (tmp_path / "uneven.json").write_text('{"hists": [[1, 2], [3]]}\n{"hists": [[1, 2], [3, 4]]}')
    code, found, _ = info(tmp_path / "uneven.json")
    assert (code, found["whole"]) == (3, False)
    (tmp_path / "uneven.csv").write_text("1,2\n3\n")
    code, _, message = info(tmp_path / "uneven.csv")
    assert code == 1
    assert "lines have from 1 to 2 columns" in message


def test_a_damaged_file_is_not_taken_for_another_kind(
    files: Path, info: Info, tmp_path: Path
) -> None:
    whole = bytearray((files / "counts73.mat").read_bytes())
    header = b"MATLAB 7.3 MAT-file"
    whole[: len(header)] = header
    (tmp_path / "header.mat").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "plain.mat").write_bytes((files / "counts.h5").read_bytes()[:1000])
    shutil.copytree(files / "image.zarr", tmp_path / "image.zarr")
    (tmp_path / "image.zarr" / ".zgroup").write_text("{")
    shutil.copytree(files / "cal.zarr", tmp_path / "cal.zarr")
    (tmp_path / "cal.zarr" / ".zgroup").write_text("{")
    for name, kind in {
        "header.mat": "a MATLAB file", "plain.mat": "an HDF5 file (.h5, .nc)",
        "image.zarr": "an image", "cal.zarr": "a calibration",
    }.items():  # fmt: skip
        code, _, message = info(tmp_path / name)
        assert code == 1
        assert f"{name}' can't be read as {kind}: it is damaged or was cut short" in " ".join(
            message.split()
        )
    with pytest.raises(FileFormatError, match="can't be read as a MATLAB file: it is damaged"):
        hf.read_counts(tmp_path / "header.mat", hf.Instrument.load(files / "camera.toml"))
