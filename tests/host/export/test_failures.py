# SPDX-License-Identifier: Apache-2.0
"""Whatever goes wrong, nothing half-written stands under a final name."""

import errno
import gc
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import hueflight as hf
from hueflight.errors import ExportError, MemoryLimitError, MissingPackageError, OutputError
from hueflight.export import FORMATS, formats, write, write_histogram, write_photons
from hueflight.files import staged


@pytest.fixture
def file_size_limit() -> Iterator[int]:
    """The kernel refuses to let any file grow beyond this many bytes, as a full disk would."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (512, hard))
    try:
        yield 512
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)


@pytest.mark.parametrize("name", FORMATS)
def test_no_format_leaves_a_partial_file(
    image: xr.Dataset, tmp_path: Path, name: str, file_size_limit: int
) -> None:
    path = tmp_path / f"scene{FORMATS[name].endings[0]}"
    with pytest.raises(OutputError, match=r"can't write '.*scene.*Nothing new was left"):
        write(image, path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", FORMATS)
def test_a_failed_replacement_keeps_the_old_file(
    image: xr.Dataset, tmp_path: Path, name: str, request: pytest.FixtureRequest
) -> None:
    path = tmp_path / f"scene{FORMATS[name].endings[0]}"
    write(image, path)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    request.getfixturevalue("file_size_limit")
    with pytest.raises(OutputError):
        write(image.isel(row=slice(None, None, 1)), path, overwrite=True)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_counts_leave_no_partial_file_either(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path, file_size_limit: int
) -> None:
    with pytest.raises(OutputError, match="File too large"):
        write_histogram(counts, camera, tmp_path / "h.h5")
    rng = np.random.default_rng(0)
    codes = rng.integers(1, 499, (400, 300, *camera.image_shape), dtype=np.uint16)
    frames = iter(codes)
    with pytest.raises(OutputError, match="File too large"):
        write_photons(frames, camera, tmp_path / "p.h5")
    assert next(frames, None) is not None, "it went on writing to a full disk"
    gc.collect()  # nothing of HDF5 may linger
    assert not list(tmp_path.iterdir())


FULL_DISK = """
import sys, xarray as xr
from hueflight.errors import OutputError
from hueflight.export import FORMATS, write
image = xr.open_dataset(sys.argv[1], engine="h5netcdf").load()
for name, entry in FORMATS.items():
    try:
        write(image, "/mnt/full/scene" + entry.endings[0])
    except OutputError as error:  # by name, and nothing lingers
        assert "the disk is full" in str(error), error
        print(name, "refused", flush=True)
import gc, os
gc.collect()
print(sorted(os.listdir("/mnt/full")))
"""


@pytest.mark.slow
def test_a_disk_that_is_really_full(
    image: xr.Dataset, camera: hf.Instrument, tmp_path: Path
) -> None:
    """A file system of 16 KB in memory, in a mount namespace of its own."""
    if not shutil.which("unshare"):
        pytest.skip("no unshare(1) here")
    # larger than the disk in every format; noise does not compress
    noise = np.random.default_rng(0).random((200, 140, 9)).astype(np.float32)
    sensor = msgspec.structs.replace(camera.sensor, rows=200, cols=140)
    big = xr.Dataset(
        {
            "depth": (("row", "col"), noise[..., 0]),
            "reflectance": (("row", "col", "band"), noise),
            "reflectance_std": (("row", "col", "band"), noise),
            "depth_std": (("row", "col"), noise[..., 1]),
            "quality": (("row", "col"), np.zeros((200, 140), np.uint16)),
        },
        coords={k: image.coords[k] for k in ("wavelength", "band_name", "emission_fwhm")},
    )
    big["depth"] = big["depth"].clip(0.01)  # a PNG of depth has no 0
    big.attrs["instrument_description"] = camera.replace(sensor=sensor).to_json()
    source = tmp_path / "image.nc"
    write(big, source)
    command = (
        "mkdir -p /mnt/full && mount -t tmpfs -o size=16k tmpfs /mnt/full && exec "
        f"{sys.executable} -c '{FULL_DISK}' {source}"
    )
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", command], capture_output=True, text=True, check=False
    )
    if "unshare" in done.stderr or "mount:" in done.stderr:
        pytest.skip(f"no mount namespace here: {done.stderr.strip()[:80]}")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:-1] == [f"{name} refused" for name in FORMATS if name != "csv"]
    assert lines[-1] == "['scene.csv']"  # a table of nine lines fits


def test_a_missing_folder_is_named(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"there is no folder '.*nowhere'"):
        write(image, tmp_path / "nowhere" / "x.tif")


def test_unknown_formats_are_named(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"ends in none of \.zarr, \.nc"):
        write(image, tmp_path / "x.mat")
    with pytest.raises(ExportError, match="no format 'mat': choose one of zarr"):
        write(image, tmp_path / "x.mat", format="mat")
    assert write(image, tmp_path / "x.data", format="csv") == [tmp_path / "x.data"]


def test_an_interrupt_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with staged(tmp_path / "x") as partial:
            partial.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", FORMATS)
def test_exhausted_memory_leaves_what_was_there(
    image: xr.Dataset, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory is lacking when the file is written and must be given its name."""
    path = tmp_path / f"scene{FORMATS[name].endings[0]}"
    write(image, path)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}

    def lack(*_: Any, **__: Any) -> None:
        raise MemoryError

    monkeypatch.setattr("hueflight.files.atomic._sync", lack)
    with pytest.raises(
        MemoryLimitError, match=r"memory is exhausted: .* was given up\. Nothing new"
    ):
        write(image, path, overwrite=True)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    assert not [p for p in tmp_path.iterdir() if p.name.endswith(".partial")]


def test_memory_that_is_lacking_for_the_removal_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, tries = shutil.rmtree, []

    def lack(*arguments: Any, **options: Any) -> None:
        tries.append(None)
        if len(tries) < 3:
            raise MemoryError
        plain(*arguments, **options)

    monkeypatch.setattr(shutil, "rmtree", lack)

    def exhausted() -> None:
        with staged(tmp_path / "x") as partial:
            partial.write_text("half")
            raise MemoryError

    with pytest.raises(MemoryLimitError, match="Nothing new"):
        exhausted()
    assert not list(tmp_path.iterdir())


def test_a_killed_writer_leaves_nothing_under_the_name(tmp_path: Path) -> None:
    script = (
        "import os, signal, sys; from pathlib import Path\n"
        "from hueflight.files.atomic import staged\n"
        "with staged(Path(sys.argv[1]) / 'x') as partial:\n"
        "    partial.write_text('half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=False)
    assert done.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".x.")
    assert left.name.endswith(".partial")


def test_the_old_folder_comes_back_when_the_rename_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "store"
    target.mkdir()
    (target / "old").write_text("old")
    rename = Path.rename

    def fails_for_the_new(self: Path, to: Path) -> Path:
        if self.name == "store" and self.parent != tmp_path:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", fails_for_the_new)
    with (
        pytest.raises(OutputError, match="Input/output error"),
        staged(target, overwrite=True) as partial,
    ):
        partial.mkdir()
    assert (target / "old").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["store"]


def test_packages_that_are_missing_are_named(
    image: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "tifffile", None)
    with pytest.raises(
        MissingPackageError, match=r"package 'tifffile': pip install 'hueflight\[export\]'"
    ):
        write(image, tmp_path / "x.tif")


def test_a_format_of_another_package(
    image: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write_text(image: xr.Dataset, path: Path, /, *, overwrite: bool, unit: str = "m") -> None:
        path.write_text(f"{float(image['depth'].mean())} {unit}", encoding="utf-8")

    theirs = formats.Format("text", (".txt",), write_text, False, "a line of text")
    monkeypatch.setitem(sys.modules, "their_package", SimpleNamespace(TEXT=theirs))
    entry = EntryPoint("text", "their_package:TEXT", formats.ENTRY_POINT_GROUP)
    monkeypatch.setattr(formats, "entry_points", lambda group: [entry])
    assert formats.write(image, tmp_path / "a.txt", unit="metres") == [tmp_path / "a.txt"]
    assert (tmp_path / "a.txt").read_text("utf-8").endswith(" metres")
