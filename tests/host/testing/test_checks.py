# SPDX-License-Identifier: Apache-2.0
"""The checks that we ship find faults: each faulty implementation fails the one it should."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from hueflight.acquisition import Acquisition
from hueflight.errors import InstrumentError
from hueflight.testing import ExporterChecks, ImporterChecks, RigChecks
from hueflight.testing.importer import ImporterExample


def test_a_check_without_its_fixtures_says_what_is_missing() -> None:
    with pytest.raises(NotImplementedError, match="read_depth"):
        ExporterChecks().read_depth(Path("x"))


def test_a_camera_that_loses_frames_fails(small: hf.Instrument) -> None:
    from support.faulty_rig import FaultyRig

    rig = FaultyRig(small)
    rig.faults.damage = 0.05
    acquisition = Acquisition(rig.connect, small)
    try:
        with pytest.raises(AssertionError, match="lost"):
            RigChecks().test_frames_and_counts_add_up(acquisition)
    finally:
        acquisition.close()


def test_a_rig_of_another_geometry_fails(small: hf.Instrument) -> None:
    from support.faulty_rig import FaultyRig

    rig = FaultyRig(small)
    with pytest.raises(hf.HueflightError, match="6 × 8 pixels"):
        RigChecks().test_it_is_the_instrument_that_it_should_be(
            rig.connect, hf.Instrument.load("paper")
        )


def test_a_reader_that_takes_short_files_fails(
    small: hf.Instrument, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import example_hueflight

    def careless(path, instrument, options, /):
        counts = np.ones(instrument.histogram_shape, np.uint32)
        return counts, instrument

    counts = np.zeros(small.histogram_shape, np.uint32)
    path = tmp_path / "a.exm"
    path.write_bytes(b"EXAMPLE\0" + counts.tobytes())
    monkeypatch.setattr(example_hueflight, "read_counts", careless)
    checks, example = ImporterChecks(), ImporterExample(path, counts, small)
    with pytest.raises(pytest.fail.Exception):
        checks.test_a_file_that_was_cut_short_is_refused(example, tmp_path, 0.3)
    with pytest.raises(pytest.fail.Exception):
        checks.test_options_without_effect_are_refused(example)


def test_a_format_that_overwrites_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import example_hueflight

    from hueflight.export import Format
    from hueflight.testing.exporter import example_image

    def careless(image, path, /, *, overwrite=False):
        np.savetxt(path, image["depth"].values)

    theirs = Format("depth-table", (".depthtable",), careless, False, "")
    monkeypatch.setattr(example_hueflight, "TEXT", theirs)
    image = example_image(hf.Instrument.load("paper"))
    checks = ExporterChecks()
    with pytest.raises(pytest.fail.Exception):
        checks.test_an_existing_file_is_kept(theirs, image, tmp_path)
    with pytest.raises(AssertionError):
        checks.test_it_says_what_it_is_for(theirs)


def test_the_example_file_is_read_only_with_an_instrument(tmp_path: Path) -> None:
    (tmp_path / "a.exm").write_bytes(b"EXAMPLE\0")
    with pytest.raises(InstrumentError, match="instrument"):
        hf.read_counts(tmp_path / "a.exm")
