# SPDX-License-Identifier: Apache-2.0
"""What a format for images must do so that `hueflight export` can offer it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import ExportError, OutputError
from hueflight.export import Format, write
from hueflight.export.formats import all_formats, format_of
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.quality import Quality

ROWS, COLS = 8, 6


class ExporterChecks:
    """Tests of a format that is installed.

    A subclass gives the fixture `format_name` and the method `read_depth`.
    """

    @pytest.fixture
    def format_name(self) -> str:
        """Return the name of the format; to be given by the subclass."""
        raise NotImplementedError("give a fixture 'format_name' that returns the format's name")

    def read_depth(self, path: Path) -> NDArray[np.floating]:
        """Read the depth from a file of the format, to compare it; to be given by the subclass.

        Parameters
        ----------
        path : pathlib.Path
            The file.

        Returns
        -------
        ndarray, shape (row, col)
            Depth in metres, NaN where unknown.
        """
        raise NotImplementedError("give a method 'read_depth' that reads a file of the format")

    @pytest.fixture
    def chosen(self, format_name: str) -> Format:
        """Return the format."""
        assert format_name in all_formats(), f"{format_name!r} is not among the formats"
        return all_formats()[format_name]

    @pytest.fixture
    def image(self) -> xr.Dataset:
        """Return an image with a row of pixels that hold nothing."""
        paper = Instrument.load("paper")
        sensor = msgspec.structs.replace(paper.sensor, rows=ROWS, cols=COLS)
        return example_image(paper.replace(sensor=sensor))

    def test_its_ending_selects_it(self, chosen: Format) -> None:
        """Each of its file extensions, in lower and upper case."""
        for ending in chosen.endings:
            assert ending == ending.lower()
            assert ending.startswith(".")
            for name in (f"scene{ending}", f"SCENE{ending.upper()}"):
                assert format_of(name).name == chosen.name

    def test_it_says_what_it_is_for(self, chosen: Format) -> None:
        """The list of formats shows a summary."""
        assert chosen.summary

    def test_what_is_written_can_be_read(
        self, chosen: Format, image: xr.Dataset, tmp_path: Path
    ) -> None:
        """Depth comes back, to the precision of the format, and unknown stays unknown."""
        path = tmp_path / f"scene{chosen.endings[0]}"
        assert write(image, path) == [path]
        depth = self.read_depth(path)
        wanted = image["depth"].transpose("row", "col").values
        assert depth.shape == wanted.shape
        assert np.array_equal(np.isnan(depth), np.isnan(wanted)), "unknown pixels must be NaN"
        np.testing.assert_allclose(depth, wanted, rtol=1e-4, atol=1e-3)

    def test_an_existing_file_is_kept(
        self, chosen: Format, image: xr.Dataset, tmp_path: Path
    ) -> None:
        """It is replaced only where this is asked for."""
        path = tmp_path / f"scene{chosen.endings[0]}"
        write(image, path)
        with pytest.raises(OutputError):
            write(image, path)
        write(image, path, overwrite=True)
        assert np.isfinite(self.read_depth(path)).any()

    def test_a_failure_leaves_nothing_behind(
        self, chosen: Format, image: xr.Dataset, tmp_path: Path
    ) -> None:
        """A folder that is missing is an error of Hueflight's family, and no file appears."""
        with pytest.raises(OutputError):
            write(image, tmp_path / "missing" / f"scene{chosen.endings[0]}")
        assert list(tmp_path.iterdir()) == []

    def test_unknown_options_are_refused(
        self, chosen: Format, image: xr.Dataset, tmp_path: Path
    ) -> None:
        """An option that the format does not have is no silent mistake of its user."""
        with pytest.raises(ExportError, match="no_such_option"):
            write(image, tmp_path / f"scene{chosen.endings[0]}", no_such_option=1)


def example_image(instrument: Instrument, /) -> xr.Dataset:
    """Return an image of made-up values, with all variables and attributes of a reconstruction.

    Parameters
    ----------
    instrument : Instrument
        Instrument that the image describes.

    Returns
    -------
    xarray.Dataset
        The image; the pixels of row 2 are unknown.
    """
    rng = np.random.default_rng(1)
    rows, cols = instrument.image_shape
    bands = len(instrument.bands)
    unknown = np.zeros((rows, cols), bool)
    unknown[2] = True

    def plane(low: float, high: float) -> NDArray[np.float32]:
        return np.where(unknown, np.nan, rng.uniform(low, high, (rows, cols))).astype(np.float32)

    def cube(low: float, high: float) -> NDArray[np.float32]:
        values = rng.uniform(low, high, (rows, cols, bands))
        return np.where(unknown[..., None], np.nan, values).astype(np.float32)

    flat, spectral = ("row", "col"), ("row", "col", "band")
    no_return = np.where(unknown, int(Quality.NO_RETURN), 0).astype(np.uint16)
    return xr.Dataset(
        {
            "depth": (flat, plane(0.5, 2.0), {"units": "m"}),
            "depth_std": (flat, plane(0.001, 0.01), {"units": "m"}),
            "reflectance": (spectral, cube(0.1, 0.9), {"units": "1"}),
            "reflectance_std": (spectral, cube(0.01, 0.02), {"units": "1"}),
            "photons": (flat, rng.poisson(500, (rows, cols)).astype(np.uint32), {"units": "count"}),
            "quality": (flat, no_return, {"units": "1"}),
        },
        coords={
            "wavelength": ("band", instrument.wavelengths_nm, {"units": "nm"}),
            "band_name": ("band", [band.name for band in instrument.bands]),
        },
        attrs={
            "instrument": instrument.name,
            "instrument_fingerprint": instrument.fingerprint(),
            "instrument_description": instrument.to_json(),
            "software": "hueflight",
        },
    )
