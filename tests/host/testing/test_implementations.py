# SPDX-License-Identifier: Apache-2.0
"""Our rigs, readers and formats, and those of another package, pass the checks that we ship."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

import hueflight as hf
from hueflight.devices.rig import Connect, rig_from_uri
from hueflight.testing import ExporterChecks, ImporterChecks, RigChecks
from hueflight.testing.importer import ImporterExample


class RigHere(RigChecks):
    @pytest.fixture
    def instrument(self, small: hf.Instrument) -> hf.Instrument:
        return small


class TestSimulatedRig(RigHere):
    kinds = ("scene", "reference", "bands", "dark")
    frames = 60

    @pytest.fixture
    def connect(self, instrument: hf.Instrument) -> Connect:
        return rig_from_uri("simulated:fig1?frames=60&distance=0.4", instrument)


class TestRigOfAnotherPackage(RigHere):
    @pytest.fixture
    def connect(self, instrument: hf.Instrument) -> Connect:
        return rig_from_uri("example:?occupancy=0.2", instrument)


class TestReaderOfArrays(ImporterChecks):
    @pytest.fixture
    def example(self, small: hf.Instrument, tmp_path: Path) -> ImporterExample:
        counts = counts_of(small)
        np.save(tmp_path / "a.npy", counts)
        return ImporterExample(tmp_path / "a.npy", counts, small)


class TestReaderOfAnotherPackage(ImporterChecks):
    @pytest.fixture
    def example(self, small: hf.Instrument, tmp_path: Path) -> ImporterExample:
        counts = counts_of(small)
        (tmp_path / "a.exm").write_bytes(b"EXAMPLE\0" + counts.tobytes())
        return ImporterExample(tmp_path / "a.exm", counts, small)


class TestTiff(ExporterChecks):
    @pytest.fixture
    def format_name(self) -> str:
        return "ome-tiff"

    def read_depth(self, path: Path) -> np.ndarray:
        with tifffile.TiffFile(path) as file:
            [planes] = [series for series in file.series if series.name == "planes"]
            return planes.pages[0].asarray()


class TestFormatOfAnotherPackage(ExporterChecks):
    @pytest.fixture
    def format_name(self) -> str:
        return "depth-table"

    def read_depth(self, path: Path) -> np.ndarray:
        return np.loadtxt(path)


def counts_of(instrument: hf.Instrument) -> np.ndarray:
    rng = np.random.default_rng(5)
    return rng.integers(0, 50, instrument.histogram_shape, dtype=np.uint32)
