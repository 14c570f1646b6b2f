# SPDX-License-Identifier: Apache-2.0
"""What a reader of counts must do so that every command can take its files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hueflight.errors import FileFormatError, HueflightError, InputNotFoundError
from hueflight.importers import read_counts
from hueflight.model.instrument import Instrument


@dataclass(frozen=True)
class ImporterExample:
    """A file whose content is known.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    counts : ndarray, shape (row, col, code)
        Counts in it.
    instrument : Instrument or None
        Instrument to read it with; None if the file states its own.
    """

    path: Path
    counts: NDArray[Any]
    instrument: Instrument | None = None


class ImporterChecks:
    """Tests of a reader that is installed; a subclass gives the fixture `example`."""

    @pytest.fixture
    def example(self) -> ImporterExample:
        """Return a file and what is in it; to be given by the subclass."""
        raise NotImplementedError("give a fixture 'example' that returns an ImporterExample")

    def test_the_counts_are_those_of_the_file(self, example: ImporterExample) -> None:
        """Every count, in the order row, column, code."""
        counts, instrument = read_counts(example.path, example.instrument)
        assert counts.shape == instrument.histogram_shape
        np.testing.assert_array_equal(counts, example.counts)
        if example.instrument is not None:
            assert instrument == example.instrument

    def test_capital_letters_make_no_difference(
        self, example: ImporterExample, tmp_path: Path
    ) -> None:
        """A file from a camera that writes capital letters is read as well."""
        path = tmp_path / f"COPY{example.path.suffix.upper()}"
        path.write_bytes(example.path.read_bytes())
        counts, _ = read_counts(path, example.instrument)
        np.testing.assert_array_equal(counts, example.counts)

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
    def test_a_file_that_was_cut_short_is_refused(
        self, example: ImporterExample, tmp_path: Path, share: float
    ) -> None:
        """The error belongs to Hueflight's family and names the file."""
        content = example.path.read_bytes()
        path = tmp_path / f"short{example.path.suffix}"
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(HueflightError, match="short"):
            read_counts(path, example.instrument)

    def test_a_file_that_is_missing_is_named(
        self, example: ImporterExample, tmp_path: Path
    ) -> None:
        """As for every other kind of file."""
        with pytest.raises(InputNotFoundError, match="missing"):
            read_counts(tmp_path / f"missing{example.path.suffix}", example.instrument)

    def test_options_without_effect_are_refused(self, example: ImporterExample) -> None:
        """An option that the reader does not use is no silent mistake of its user."""
        with pytest.raises(FileFormatError):
            read_counts(example.path, example.instrument, dataset="no such part", channel=97)
