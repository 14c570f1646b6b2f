import dataclasses
import json

import numpy as np
import pytest
import zarr

import hueflight as hf
from hueflight.errors import CalibrationError


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
    with pytest.raises(CalibrationError, match="exists: choose another name"):
        calibration.save(saved)
    moved = dataclasses.replace(calibration, distance=0.7)
    moved.save(saved, overwrite=True)
    assert hf.Calibration.load(saved).distance == 0.7
    assert list(saved.parent.iterdir()) == [saved]


def test_a_failed_write_leaves_nothing_under_the_name(calibration, tmp_path, monkeypatch):
    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zarr.Group, "create_array", full_disk)
    with pytest.raises(CalibrationError, match="No space left"):
        calibration.save(tmp_path / "cal.zarr")
    assert not list(tmp_path.iterdir())


def test_a_failed_overwrite_keeps_the_old_one(calibration, saved, monkeypatch):
    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zarr.Group, "create_array", full_disk)
    with pytest.raises(CalibrationError, match="No space left"):
        calibration.save(saved, overwrite=True)
    monkeypatch.undo()
    assert hf.Calibration.load(saved).distance == calibration.distance


def test_nothing_there(tmp_path):
    with pytest.raises(CalibrationError, match="there is no such folder"):
        hf.Calibration.load(tmp_path / "absent.zarr")


@pytest.mark.parametrize("content", ["folder", "file"])
def test_what_is_no_store(tmp_path, content):
    path = tmp_path / "thing"
    if content == "folder":
        path.mkdir()
    else:
        path.write_text("no Zarr")
    with pytest.raises(CalibrationError, match="is not a calibration: Zarr can't open it"):
        hf.Calibration.load(path)


def test_a_foreign_store(tmp_path):
    zarr.create_group(tmp_path / "other.zarr").attrs["title"] = "weather"
    with pytest.raises(CalibrationError, match="Zarr store whose format is None"):
        hf.Calibration.load(tmp_path / "other.zarr")


def edit(saved, **changes):
    meta = saved / "zarr.json"
    tree = json.loads(meta.read_text())
    tree["attributes"].update(changes)
    meta.write_text(json.dumps(tree))


def test_a_later_format(saved):
    edit(saved, format_number=99)
    with pytest.raises(CalibrationError, match="format 99, this software reads 1"):
        hf.Calibration.load(saved)


def test_an_edited_instrument(saved, calibration):
    changed = calibration.instrument.to_json().replace("0.642", "0.7")
    edit(saved, instrument=changed)
    with pytest.raises(CalibrationError, match="does not match its fingerprint"):
        hf.Calibration.load(saved)


def test_a_missing_array(saved):
    (saved / "gain" / "zarr.json").unlink()
    with pytest.raises(CalibrationError, match="is damaged"):
        hf.Calibration.load(saved)


def test_a_broken_chunk(saved):
    chunk = next(p for p in (saved / "reference" / "c").rglob("*") if p.is_file())
    chunk.write_bytes(b"\x00" * 10)
    with pytest.raises(CalibrationError, match="is damaged"):
        hf.Calibration.load(saved)


def test_a_missing_chunk(saved):
    chunk = next(p for p in (saved / "reference" / "c").rglob("*") if p.is_file())
    chunk.unlink()  # Zarr would read zeros
    with pytest.raises(CalibrationError, match="is damaged"):
        hf.Calibration.load(saved)
