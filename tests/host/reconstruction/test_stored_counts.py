# SPDX-License-Identifier: Apache-2.0
"""Histograms that stay on disk: the same image, and memory that does not grow with the file."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
import zarr

import hueflight as hf
from hueflight.errors import HistogramError, MemoryLimitError
from hueflight.memory import LIMIT_NAME
from hueflight.reconstruction import stored_counts


@pytest.fixture(scope="module")
def setting(small, draw):
    instrument = small(rows=24, cols=10)
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    return instrument, calibration, draw(instrument, depth=0.9, photons=800, background=100)


def as_memory_map(folder, counts):
    np.save(folder / "counts.npy", counts)
    return np.load(folder / "counts.npy", mmap_mode="r")


def as_zarr(folder, counts):
    return zarr.create_array(folder / "counts.zarr", data=counts, chunks=(5, *counts.shape[1:]))


def as_hdf5(folder, counts):
    h5py = pytest.importorskip("h5py")
    return h5py.File(folder / "counts.h5", "w").create_dataset("counts", data=counts)


STORES = {"memory map": as_memory_map, "zarr": as_zarr, "hdf5": as_hdf5}


@pytest.mark.parametrize("store", STORES.values(), ids=STORES.keys())
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float64])
@pytest.mark.parametrize("method", ["joint", "paper", "pooled"])
def test_the_image_is_the_same(setting, tmp_path, monkeypatch, store, dtype, method):
    _, calibration, counts = setting
    counts = np.minimum(counts, 255).astype(dtype)
    monkeypatch.setattr(stored_counts, "BLOCK_BYTES", 6 * counts[0].nbytes)
    stored = store(tmp_path, counts)
    image = hf.reconstruct(stored, calibration, method=method)
    expected = hf.reconstruct(counts, calibration, method=method)
    for name, values in expected.data_vars.items():
        np.testing.assert_allclose(image[name], values, rtol=1e-6, atol=1e-9, err_msg=name)


def test_rows_that_are_not_asked_for_are_not_read(setting, tmp_path, monkeypatch):
    _, calibration, counts = setting
    monkeypatch.setattr(stored_counts, "BLOCK_BYTES", 6 * counts[0].nbytes)
    region = np.s_[0:4, 2:8]
    image = hf.reconstruct(as_memory_map(tmp_path, counts), calibration, region=region)
    expected = hf.reconstruct(counts, calibration, region=region)
    np.testing.assert_allclose(image["depth"], expected["depth"], rtol=1e-6)
    assert np.isfinite(image["depth"].values).sum() == 24


@pytest.mark.parametrize("method", ["joint", "paper", "pooled"])
@pytest.mark.parametrize("dtype", ["=u2", "<u2", ">u2"])
def test_counts_in_any_order_of_bytes_that_are_not_aligned(setting, method, dtype):
    _, calibration, counts = setting
    counts = counts.astype(np.uint16)
    memory = np.empty(counts.nbytes + 1, np.uint8)
    odd = memory[1:].view(dtype).reshape(counts.shape)
    odd[...] = counts
    assert not odd.flags.aligned
    image = hf.reconstruct(odd, calibration, method=method)
    expected = hf.reconstruct(counts, calibration, method=method)
    np.testing.assert_array_equal(image["depth"], expected["depth"])


def test_blocks_are_whole_chunks(setting, tmp_path, monkeypatch):
    _, calibration, counts = setting
    stored = stored_counts.StoredCounts(as_zarr(tmp_path, counts), calibration.bins)
    monkeypatch.setattr(stored_counts, "BLOCK_BYTES", 13 * counts[0].nbytes)
    rows = [rows for rows, _ in stored.blocks()]
    assert [(s.start, s.stop) for s in rows] == [(0, 10), (10, 20), (20, 24)]
    some = np.array([0, 3, 99, 100, 101, 239])
    light = calibration.bins.in_time_order(counts).reshape(240, -1)
    np.testing.assert_array_equal(stored[some], light[some])
    monkeypatch.setattr(stored_counts, "BLOCK_BYTES", 1)
    assert stored.block_rows == 5  # no less than a chunk


def test_faults_of_counts_on_disk(setting, tmp_path):
    _, calibration, counts = setting
    with pytest.raises(HistogramError, match="shape"):
        hf.reconstruct(as_memory_map(tmp_path, counts[:, :4]), calibration)
    with pytest.raises(HistogramError, match="empty"):
        hf.reconstruct(as_memory_map(tmp_path, np.zeros_like(counts)), calibration)
    negative = counts.astype(np.float32)
    negative[20, 3, 7] = np.nan
    with pytest.raises(HistogramError, match=r"rows 0 to 23 .*not finite"):
        hf.reconstruct(as_memory_map(tmp_path, negative), calibration)


def test_other_methods_are_refused_where_counts_do_not_fit(setting, tmp_path, monkeypatch):
    _, calibration, counts = setting
    stored = as_zarr(tmp_path, counts)
    monkeypatch.setattr(stored_counts, "BLOCK_BYTES", 1)
    monkeypatch.setenv(LIMIT_NAME, "1 kB")
    for method in ("pooled", "joint"):
        with pytest.raises(MemoryLimitError, match="the reconstruction of 240 pixels"):
            hf.reconstruct(stored, calibration, method=method)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are those of Linux")
def test_a_histogram_larger_than_memory(tmp_path):
    """537 MB of counts under a limit of 500 MB for the data of the process."""
    code = f"""
        import resource, sys
        import numpy as np, zarr
        import hueflight as hf
        from hueflight.reconstruction import joint
        import xarray, scipy.sparse
        from hueflight.model.instrument import Band, Instrument, Sensor, Timing

        sensor = Sensor(rows=1024, cols=256, code_bits=10, bin_width_ns=0.1)
        band = Band(name="red", wavelength_nm=640, delay_ns=30, pulse_fwhm_ns=2)
        wide = Instrument(
            name="wide", bands=(band,), sensor=sensor, timing=Timing(period_ns=102.4)
        )
        part = wide.replace(sensor=Sensor(rows=4, cols=256, code_bits=10, bin_width_ns=0.1))
        time = (np.arange(1024) + 0.5) * 0.1
        def board(rows, depth, seed):
            center = 30 + 2 * depth / 0.299792458
            mean = 400 * np.exp(-((time - center) / 2 * 2.3548) ** 2 / 2) / 8.5 / 2.5 + 0.2
            return np.random.default_rng(seed).poisson(mean, (rows, 256, 1024)).astype(np.uint16)
        some = hf.calibrate(board(4, 1.0, 1), part, distance=1.0)
        def taller(plane):
            return np.tile(plane, (256, *(1,) * (plane.ndim - 1)))
        import dataclasses
        names = [field.name for field in dataclasses.fields(some)]
        planes = [n for n in names if np.shape(getattr(some, n)) == (4, 256)]
        empty = np.broadcast_to(np.float32(1), (1024, 256, 1024))
        calibration = dataclasses.replace(
            some, instrument=wide, reference=empty, frames=None,
            **{{name: taller(getattr(some, name)) for name in planes}},
        )
        store = zarr.create_array(
            {str(tmp_path / "wide.zarr")!r}, shape=(1024, 256, 1024), dtype=np.uint16,
            chunks=(32, 256, 1024), compressors=None,
        )
        block = board(32, 1.3, 2)
        for row in range(0, 1024, 32):
            store[row : row + 32] = block
        assert store.nbytes == 1024 * 256 * 1024 * 2
        del block
        resource.setrlimit(resource.RLIMIT_DATA, (500_000_000, 500_000_000))
        try:
            np.ones(store.shape, np.uint16)
        except MemoryError:
            pass
        else:
            sys.exit("the limit does not hold")
        image = hf.reconstruct(store, calibration)
        depth, std = image.depth.values, image.depth_std.values
        assert np.isfinite(depth).all(), np.isnan(depth).mean()
        assert abs(depth.mean() - 1.3) < 0.002, depth.mean()
        assert 0.9 < (depth - 1.3)[:32].std() / std[:32].mean() < 1.1
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        env={"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": ":".join(sys.path), "PATH": ""},
    )
    assert done.returncode == 0, done.stderr
