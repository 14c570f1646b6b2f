# SPDX-License-Identifier: Apache-2.0
import dataclasses
import json
import pickle
import shutil

import google_crc32c
import numpy as np
import pytest
import xarray as xr
import zarr

import hueflight as hf
from hueflight.calibration import store
from hueflight.errors import (
    CalibrationError,
    CalibrationNotFoundError,
    OutputError,
    OutputExistsError,
)
from hueflight.export.description import calibration_origin
from hueflight.files import write_checksums
from hueflight.model.instrument import Band


@pytest.fixture(scope="module")
def calibration(small, draw):
    instrument = small()
    return hf.calibrate(draw(instrument, photons=5000), instrument, distance=0.4)


@pytest.fixture
def saved(calibration, tmp_path):
    path = tmp_path / "cal.zarr"
    calibration.save(path)
    return path


def test_what_is_saved_is_what_is_loaded(calibration, saved):
    loaded = hf.Calibration.load(saved)
    for field in dataclasses.fields(calibration):
        mine, theirs = getattr(calibration, field.name), getattr(loaded, field.name)
        if isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(mine, theirs)
            assert mine.dtype == theirs.dtype
        elif field.name == "bins":
            np.testing.assert_array_equal(mine.edges_ns, theirs.edges_ns)
            np.testing.assert_array_equal(mine.codes, theirs.codes)
            assert mine.period_ns == theirs.period_ns
        elif field.name == "templates":
            np.testing.assert_array_equal(mine.coefficients, theirs.coefficients)
            assert mine.circle_ns == theirs.circle_ns
        else:
            assert mine == theirs


def test_without_known_frames(small, draw, tmp_path):
    instrument = small(code_zero="bin")
    calibration = hf.calibrate(draw(instrument), instrument, distance=0.4)
    calibration.save(tmp_path / "cal.zarr")
    assert hf.Calibration.load(tmp_path / "cal.zarr").frames is None


def test_the_store_says_what_it_is_to_other_tools(calibration, saved):
    group = zarr.open_group(saved, mode="r")
    assert group.attrs["instrument_fingerprint"] == calibration.instrument.fingerprint()
    assert group.attrs["distance_m"] == 0.4
    assert group.attrs["provenance"]["reference_photons"] > 0
    assert group["reference"].shape == calibration.reference.shape


def test_a_taken_name_is_kept_unless_told_otherwise(calibration, saved):
    with pytest.raises(OutputExistsError, match="exists already: choose another name"):
        calibration.save(saved)
    moved = dataclasses.replace(calibration, distance=0.7)
    moved.save(saved, overwrite=True)
    assert hf.Calibration.load(saved).distance == 0.7
    assert list(saved.parent.iterdir()) == [saved]


def test_a_failed_write_leaves_nothing_under_the_name(calibration, tmp_path, monkeypatch):
    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zarr.Group, "create_array", full_disk)
    with pytest.raises(OutputError, match="No space left"):
        calibration.save(tmp_path / "cal.zarr")
    assert not list(tmp_path.iterdir())


def test_a_failed_overwrite_keeps_the_old_one(calibration, saved, monkeypatch):
    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zarr.Group, "create_array", full_disk)
    with pytest.raises(OutputError, match="No space left"):
        calibration.save(saved, overwrite=True)
    monkeypatch.undo()
    assert hf.Calibration.load(saved).distance == calibration.distance


def test_nothing_there(tmp_path):
    with pytest.raises(CalibrationNotFoundError, match="there is no such folder"):
        hf.Calibration.load(tmp_path / "absent.zarr")


@pytest.mark.parametrize("content", ["folder", "file"])
def test_what_is_no_store(tmp_path, content):
    path = tmp_path / "thing"
    if content == "folder":
        path.mkdir()
    else:
        path.write_text("no Zarr")
    with pytest.raises(CalibrationError, match=r"is a (folder|text file), not a calibration"):
        hf.Calibration.load(path)


def test_a_foreign_store(tmp_path):
    zarr.create_group(tmp_path / "other.zarr").attrs["title"] = "weather"
    with pytest.raises(CalibrationError, match="is a Zarr store, not a calibration"):
        hf.Calibration.load(tmp_path / "other.zarr")


def edit(saved, **changes):
    attributes = saved / ".zattrs"
    attributes.write_text(json.dumps(json.loads(attributes.read_text()) | changes))


def test_a_later_format(saved):
    edit(saved, format_number=99)
    with pytest.raises(CalibrationError, match="format 99, this software reads 1 and 2"):
        hf.Calibration.load(saved)


def test_an_edited_instrument(saved, calibration):
    changed = calibration.instrument.to_json().replace("0.642", "0.7")
    edit(saved, instrument=changed)
    with pytest.raises(CalibrationError, match=r"damaged: .*\.zattrs"):
        hf.Calibration.load(saved)
    write_checksums(saved)
    with pytest.raises(CalibrationError, match="does not match its fingerprint"):
        hf.Calibration.load(saved)


def test_a_missing_array(saved):
    (saved / "gain" / ".zarray").unlink()
    with pytest.raises(CalibrationError, match="is damaged"):
        hf.Calibration.load(saved)


def test_a_broken_chunk(saved):
    chunk = saved / "reference" / "0.0.0"
    chunk.write_bytes(b"\x00" * 10)
    with pytest.raises(CalibrationError, match="is damaged"):
        hf.Calibration.load(saved)


def test_a_missing_chunk(saved):
    chunk = saved / "reference" / "0.0.0"
    chunk.unlink()  # Zarr would read zeros
    with pytest.raises(CalibrationError, match="is damaged"):
        hf.Calibration.load(saved)


def test_a_missing_list_of_checksums(saved):
    (saved / ".checksums").unlink()
    with pytest.raises(CalibrationError, match=r"damaged: .*list \.checksums is missing"):
        hf.Calibration.load(saved)


def as_format_1(saved, path):
    """The same calibration as versions 0.1 wrote it: Zarr format 3, checksums of the values."""
    new = zarr.open_group(saved, mode="r")
    old = zarr.create_group(path, zarr_format=3)
    checksums = {}
    for name in (member.name for member in saved.iterdir() if member.is_dir()):
        array = new[name]
        old.create_array(name, data=array[...])
        checksums[name] = google_crc32c.value(array[...].tobytes())
    old.attrs.update(dict(new.attrs) | {"format_number": 1, "crc32c": checksums})


def test_format_1_still_opens(calibration, saved, tmp_path):
    as_format_1(saved, tmp_path / "old.zarr")
    old = hf.Calibration.load(tmp_path / "old.zarr")
    np.testing.assert_array_equal(old.reference, calibration.reference)
    np.testing.assert_array_equal(old.pixel_delay_ns, calibration.pixel_delay_ns)
    assert old.windows == calibration.windows
    assert old.provenance == calibration.provenance


def test_a_missing_chunk_of_format_1(saved, tmp_path):
    as_format_1(saved, tmp_path / "old.zarr")
    chunk = next(p for p in (tmp_path / "old.zarr" / "gain" / "c").rglob("*") if p.is_file())
    chunk.unlink()
    with pytest.raises(CalibrationError, match="gain does not match its checksum"):
        hf.Calibration.load(tmp_path / "old.zarr")


def test_numbers_without_a_point(calibration, tmp_path):
    """An instrument described with 640 is the one described with 640.0."""
    bands = tuple(
        Band(
            name=band.name,
            wavelength_nm=int(band.wavelength_nm),
            delay_ns=band.delay_ns,
            pulse_fwhm_ns=band.pulse_fwhm_ns,
        )
        for band in calibration.instrument.bands
    )
    instrument = calibration.instrument.replace(bands=bands)
    dataclasses.replace(calibration, instrument=instrument).save(tmp_path / "cal.zarr")
    assert hf.Calibration.load(tmp_path / "cal.zarr").instrument == instrument


@pytest.fixture
def deferred(monkeypatch):
    monkeypatch.setattr(store, "DEFERRED_BYTES", 0)
    monkeypatch.setattr(store, "CHUNK_BYTES", 3000)  # several runs of rows


def test_a_large_reference_stays_on_disk(calibration, deferred, tmp_path, draw, monkeypatch):
    path = tmp_path / "cal.zarr"
    calibration.save(path)
    loaded = hf.Calibration.load(path)
    scene = draw(calibration.instrument, depth=0.7, photons=800)
    with monkeypatch.context() as patched:
        patched.setattr(store.StoredReference, "read", lambda _: pytest.fail("it was read"))
        image = hf.reconstruct(scene, loaded)
        assert calibration_origin(loaded) == calibration_origin(calibration)
        np.testing.assert_array_equal(
            np.concatenate(list(loaded.reference_blocks())), calibration.reference
        )
        assert len(list(loaded.reference_blocks())) > 1
    xr.testing.assert_identical(image, hf.reconstruct(scene, calibration))
    elsewhere = pickle.loads(pickle.dumps(hf.Calibration.load(path)))
    loaded.save(tmp_path / "copy.zarr")
    shutil.rmtree(path)
    again = hf.Calibration.load(tmp_path / "copy.zarr")
    for one in (loaded, elsewhere, again):
        np.testing.assert_array_equal(one.reference, calibration.reference)


def test_a_reference_is_summed_once(calibration, deferred, tmp_path, draw, monkeypatch):
    path = tmp_path / "cal.zarr"
    calibration.save(path)
    loaded = hf.Calibration.load(path)
    scene = draw(calibration.instrument, depth=0.7, photons=800)
    blocks, reads = store.StoredReference.blocks, []

    def count_reads(stored):
        reads.append(stored)
        return blocks(stored)

    monkeypatch.setattr(store.StoredReference, "blocks", count_reads)
    images = [hf.reconstruct(scene, loaded, pileup_correction=False) for _ in range(2)]
    hf.check_image(scene, loaded, images[0])
    assert len(reads) == 1
    expected = hf.reconstruct(scene, calibration, pileup_correction=False)
    for image in images:
        xr.testing.assert_identical(image, expected)


def test_a_calibration_that_was_replaced_is_not_mixed_with_the_new_one(
    calibration, deferred, tmp_path
):
    path = tmp_path / "cal.zarr"
    calibration.save(path)
    loaded = hf.Calibration.load(path)
    other = dataclasses.replace(calibration, reference=calibration.reference + 1)
    other.save(path, overwrite=True)
    with pytest.raises(CalibrationError, match=r"was replaced or removed .*: load it again"):
        _ = loaded.reference
