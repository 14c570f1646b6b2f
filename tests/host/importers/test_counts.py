# SPDX-License-Identifier: Apache-2.0
"""Counts of any camera from NumPy, Zarr and HDF5 files."""

import sys
from importlib.metadata import EntryPoint
from itertools import permutations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import msgspec
import numpy as np
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import hueflight as hf
from hueflight.errors import FileFormatError, HistogramError, InstrumentError, OutputError
from hueflight.export import write_histogram
from hueflight.importers import ReadOptions, read_capture, read_counts, readers, write_counts
from hueflight.importers.arrays import arranged, count_codes
from hueflight.model.histograms import check_histogram

CAMERA = hf.Instrument.from_toml(
    """
    name = "someone's camera"
    [sensor]
    rows = 3
    cols = 4
    code_bits = 6
    bin_width_ns = 1.0
    [[bands]]
    name = "red"
    wavelength_nm = 650
    """
)


@pytest.fixture
def counts() -> NDArray[np.uint32]:
    return np.random.default_rng(0).poisson(3.0, CAMERA.histogram_shape).astype(np.uint32)


def test_numpy_zarr_and_hdf5_give_the_same(counts: NDArray[Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", counts)
    np.savez_compressed(tmp_path / "b.npz", counts)
    zarr.save_array(tmp_path / "c.zarr", counts)
    with zarr.config.set({}):
        group = zarr.open_group(tmp_path / "d.zarr", mode="w")
        group.create_array("raw/histogram", data=counts)
    with h5py.File(tmp_path / "e.h5", "w") as file:
        file["measurement/run1"] = counts
    for path in sorted(tmp_path.iterdir()):
        found, instrument = read_counts(path, CAMERA)
        np.testing.assert_array_equal(found, counts, err_msg=path.name)
        assert instrument == CAMERA


def test_our_own_files_say_which_instrument(counts: NDArray[Any], tmp_path: Path) -> None:
    write_histogram(counts, CAMERA, tmp_path / "h.h5")
    np.savez(tmp_path / "h.npz", histogram=counts, instrument=np.array(CAMERA.to_json()))
    for name in ("h.h5", "h.npz"):
        found, instrument = read_counts(tmp_path / name)
        np.testing.assert_array_equal(found, counts)
        assert instrument == CAMERA
        with pytest.raises(InstrumentError, match="was made by instrument"):
            read_counts(tmp_path / name, hf.Instrument.load("paper"))


def test_one_of_several_arrays_is_asked_for(counts: NDArray[Any], tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["one"], file["two"] = counts, counts + 1
    np.savez(tmp_path / "x.npz", one=counts, two=counts + 1)
    for name in ("x.h5", "x.npz"):
        np.testing.assert_array_equal(
            read_counts(tmp_path / name, CAMERA, dataset="two")[0], counts + 1
        )
        with pytest.raises(FileFormatError, match=r"holds 2 arrays \(one, two\): say which"):
            read_counts(tmp_path / name, CAMERA)
        with pytest.raises(FileFormatError, match="has no array 'three': it has one, two"):
            read_counts(tmp_path / name, CAMERA, dataset="three")


@pytest.mark.parametrize("order", list(permutations(("row", "col", "code"))))
def test_axes_in_any_order(counts: NDArray[Any], order: tuple[str, ...]) -> None:
    stored = counts.transpose([("row", "col", "code").index(name) for name in order])
    np.testing.assert_array_equal(arranged(stored, ",".join(order), CAMERA), counts)
    np.testing.assert_array_equal(
        arranged(stored[None, ..., None], f"-,{','.join(order)},-", CAMERA), counts
    )


@given(st.integers(0, 2**32 - 1), st.integers(0, 30))
@settings(max_examples=30)
def test_frames_of_codes_are_counted(seed: int, frames: int) -> None:
    codes = np.random.default_rng(seed).integers(0, 64, (frames, 3, 4))
    wanted = np.zeros(CAMERA.histogram_shape, int)
    for frame in codes:
        for row in range(3):
            for col in range(4):
                wanted[row, col, frame[row, col]] += 1
    np.testing.assert_array_equal(count_codes(codes, CAMERA), wanted)
    turned = arranged(codes.transpose(2, 0, 1), "col, frame, row", CAMERA)
    np.testing.assert_array_equal(turned, wanted)


def test_axes_that_do_not_fit_are_named(counts: NDArray[Any]) -> None:
    with pytest.raises(FileFormatError, match="names 2 axes but the array has shape"):
        arranged(counts, "row,col", CAMERA)
    with pytest.raises(FileFormatError, match="name row, col and code"):
        arranged(counts, "row,col,time", CAMERA)
    with pytest.raises(FileFormatError, match="has length 3, not 1"):
        arranged(counts, "-,col,code", CAMERA)


def test_wild_codes_are_refused() -> None:
    codes = np.zeros((5, 3, 4), np.int16)
    codes[2, 1, 3] = 64
    with pytest.raises(FileFormatError, match=r"code 64 at .* = \(2, 1, 3\) is outside 0\.\.63"):
        count_codes(codes, CAMERA)
    codes[2, 1, 3] = -1
    with pytest.raises(FileFormatError, match="code -1"):
        count_codes(codes, CAMERA)
    with pytest.raises(FileFormatError, match="float64"):
        count_codes(codes.astype(float), CAMERA)


def test_counts_that_are_no_counts(counts: NDArray[Any], tmp_path: Path) -> None:
    np.save(tmp_path / "n.npy", counts.astype(float) * np.nan)
    with pytest.raises(HistogramError, match="counts must be finite"):
        read_counts(tmp_path / "n.npy", CAMERA)
    np.save(tmp_path / "c.npy", counts.astype(complex))
    with pytest.raises(HistogramError, match="complex128: counts must be numbers"):
        read_counts(tmp_path / "c.npy", CAMERA)
    np.save(tmp_path / "s.npy", counts[:2])
    with pytest.raises(HistogramError, match="number of pixels differs"):
        read_counts(tmp_path / "s.npy", CAMERA)


def test_damaged_files_are_named_not_trusted(counts: NDArray[Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", counts)
    np.savez(tmp_path / "a.npz", counts)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = counts
    for name in ("a.npy", "a.npz", "a.h5"):
        whole = (tmp_path / name).read_bytes()
        for keep in (0, 10, len(whole) // 2, len(whole) - 100):
            (tmp_path / name).write_bytes(whole[:keep])
            with pytest.raises(FileFormatError, match=name):
                read_counts(tmp_path / name, CAMERA)
    np.save(tmp_path / "o.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match="can't be read"):
        read_counts(tmp_path / "o.npy", CAMERA)  # a pickle runs what it contains
    (tmp_path / "empty.zarr").mkdir()
    with pytest.raises(FileFormatError, match=r"empty\.zarr"):
        read_counts(tmp_path / "empty.zarr", CAMERA)


def test_files_that_are_not_there_or_of_other_kinds(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="there is no such file"):
        read_counts(tmp_path / "x.npy", CAMERA)
    (tmp_path / "x.bmp").write_bytes(b"BM\x00\xff")
    with pytest.raises(FileFormatError, match=r"not read from files that end in '\.bmp'.*\.npy"):
        read_counts(tmp_path / "x.bmp", CAMERA)
    np.save(tmp_path / "x.npy", np.ones((3, 4, 64)))
    with pytest.raises(InstrumentError, match="does not say which instrument"):
        read_counts(tmp_path / "x.npy")
    with pytest.raises(FileFormatError, match="leave dataset out"):
        read_counts(tmp_path / "x.npy", CAMERA, dataset="x")


def periodic(period_ns: float) -> hf.Instrument:
    """The camera with a period of fewer bins than its 64 codes."""
    timing = msgspec.structs.replace(CAMERA.timing, period_ns=period_ns)
    return CAMERA.replace(timing=timing)


def test_as_many_bins_as_the_period_needs(counts: NDArray[Any], tmp_path: Path) -> None:
    camera = periodic(59.5)  # 60 bins of 1 ns, the last of which is partial
    for bins in (60, 62):
        np.save(tmp_path / "a.npy", counts[..., :bins])
        found, _ = read_counts(tmp_path / "a.npy", camera)
        np.testing.assert_array_equal(found[..., :bins], counts[..., :bins])
        assert found.shape == counts.shape
        assert not found[..., bins:].any()
    np.save(tmp_path / "a.npy", counts[..., :59])
    with pytest.raises(HistogramError, match="number of codes differs"):
        read_counts(tmp_path / "a.npy", camera)
    np.save(tmp_path / "a.npy", counts[..., :60])  # without a period every code is needed
    with pytest.raises(HistogramError, match="number of codes differs"):
        read_counts(tmp_path / "a.npy", CAMERA)


def test_counts_beyond_the_period_are_reported(counts: NDArray[Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", counts)
    capture = read_capture(tmp_path / "a.npy", periodic(60))
    assert capture.losses == {"outside_period": int(counts[..., 60:].sum())}
    np.testing.assert_array_equal(capture.counts, counts)
    assert not read_capture(tmp_path / "a.npy", CAMERA).losses


def test_masked_counts_are_refused(counts: NDArray[Any]) -> None:
    masked = np.ma.MaskedArray(counts, mask=np.zeros(counts.shape, bool))
    np.testing.assert_array_equal(check_histogram(masked, CAMERA), counts)
    masked[1, 2] = np.ma.masked
    with pytest.raises(HistogramError, match="has 64 masked counts"):
        check_histogram(masked, CAMERA)


def test_text_of_a_user_in_the_place_of_an_instrument(counts: NDArray[Any], tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", histogram=counts, instrument=np.array("my camera"))
    with pytest.raises(FileFormatError, match=r"the entry 'instrument' is reserved .* 'my camera'"):
        read_counts(tmp_path / "a.npz", CAMERA)


def test_extensions_in_upper_case(counts: NDArray[Any], tmp_path: Path) -> None:
    zarr.save_array(tmp_path / "a.ZARR", counts)
    np.save(tmp_path / "b.npy", counts)
    (tmp_path / "b.npy").rename(tmp_path / "b.NPY")
    for name in ("a.ZARR", "b.NPY"):
        np.testing.assert_array_equal(read_counts(tmp_path / name, CAMERA)[0], counts)


def test_a_reader_of_another_package(
    counts: NDArray[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_raw(
        path: Path, instrument: hf.Instrument | None, options: ReadOptions, /
    ) -> tuple[NDArray[Any], hf.Instrument]:
        options.refuse_all_but(path=path)
        assert instrument is not None
        read = np.fromfile(path, np.uint32).reshape(instrument.histogram_shape)
        return read, instrument

    monkeypatch.setitem(sys.modules, "their_package", SimpleNamespace(read_raw=read_raw))
    entry = EntryPoint("raw", "their_package:read_raw", readers.ENTRY_POINT_GROUP)
    monkeypatch.setattr(readers, "entry_points", lambda group: [entry])
    counts.tofile(tmp_path / "a.raw")
    np.testing.assert_array_equal(read_counts(tmp_path / "a.raw", CAMERA)[0], counts)
    (tmp_path / "a.txt").touch()
    with pytest.raises(FileFormatError, match=r"is an empty file, .*\.sdt, \.raw"):
        read_counts(tmp_path / "a.txt", CAMERA)


def test_counts_are_written_whole_or_not_at_all(
    counts: NDArray[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.npz"
    write_counts(path, counts, CAMERA)
    before = path.read_bytes()
    capture = read_capture(path)
    np.testing.assert_array_equal(capture.counts, counts)
    assert capture.instrument == CAMERA

    def fail(file: Path, **arrays: NDArray[Any]) -> None:
        file.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OutputError, match="No space left"):
        write_counts(path, counts, CAMERA)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
