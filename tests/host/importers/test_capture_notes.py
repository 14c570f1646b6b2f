# SPDX-License-Identifier: Apache-2.0
"""What recordings state about themselves, and who is held to it."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest

import hueflight as hf
from hueflight.cli import main
from hueflight.files.ages import age
from hueflight.importers.captures import read_capture


@pytest.fixture(scope="module")
def recordings(tmp_path_factory, small):
    """Simulated recordings by their kind, of a few pixels."""
    folder = tmp_path_factory.mktemp("recordings")
    instrument = small(rows=4, cols=8).replace(lens=hf.Instrument.load("paper").lens)
    description = folder / "small.toml"
    description.write_text(instrument.to_toml())
    made = {}
    for kind in ("scene", "reference", "bands", "dark"):
        made[kind] = folder / f"{kind}.mcap"
        command = ["simulate", "--capture", kind, "--out", str(made[kind]), "--frames", "3000"]
        with pytest.raises(SystemExit) as ended:
            main([*command, "--instrument", str(description), "--json"])
        assert ended.value.code in (None, 0)
    return made


def calibrate(reference, out, *options, distance="0.4"):
    words = ["calibrate", str(reference), "--distance", distance, "--out", str(out), *options]
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code or 0


def test_notes_are_read(recordings):
    capture = read_capture(recordings["reference"])
    assert capture.notes["capture"] == "reference"
    assert float(capture.notes["distance_m"]) == 0.4
    assert repr(capture).startswith("<reference at 0.4 m of 'paper', (4, 8, 512), recorded ")
    assert "just now" in repr(capture) or "minute" in repr(capture)
    assert capture.contradictions(kind="reference", distance=0.4) == []
    assert len(capture.contradictions(kind="dark", distance=40)) == 2
    assert "distance_m" not in read_capture(recordings["scene"]).notes


def test_a_scene_is_no_reference(recordings, tmp_path, capsys):
    assert calibrate(recordings["scene"], tmp_path / "a.zarr") != 0
    assert "recorded as 'scene', not as 'reference'" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "a.zarr").exists()


def test_centimeters_for_meters(recordings, tmp_path, capsys):
    assert calibrate(recordings["reference"], tmp_path / "b.zarr", distance="40") != 0
    assert "states a distance of 0.4 m, not 40 m" in " ".join(capsys.readouterr().err.split())


def test_a_reference_is_no_dark_capture(recordings, tmp_path, capsys):
    options = ("--dark", str(recordings["reference"]))
    assert calibrate(recordings["reference"], tmp_path / "c.zarr", *options) != 0
    assert "not as 'dark'" in " ".join(capsys.readouterr().err.split())


def test_recordings_that_agree_are_taken(recordings, tmp_path):
    options = ("--bands", str(recordings["bands"]), "--dark", str(recordings["dark"]))
    assert calibrate(recordings["reference"], tmp_path / "d.zarr", *options) == 0
    calibration = hf.Calibration.load(tmp_path / "d.zarr")
    made = calibration.provenance["created"]
    assert calibration.facts()["created"] == f"{made} ({age(made)})"


def test_notes_can_be_ignored(recordings, tmp_path):
    out = tmp_path / "e.zarr"
    assert calibrate(recordings["reference"], out, "--ignore-notes", distance="0.41") == 0
    assert hf.Calibration.load(out).distance == 0.41


def test_kind_and_age_are_shown(recordings, capsys):
    with pytest.raises(SystemExit):
        main(["info", str(recordings["reference"]), "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert facts["metadata"]["capture"] == "reference"
    assert facts["age"] == "just now" or "ago" in facts["age"]


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ("2026-03-04T12:00:00+00:00", "just now"),
        ("2026-03-04T11:30:00", "30 minutes ago"),
        ("2026-03-04T12:00:00+02:00", "2 hours ago"),
        ("2026-03-03T11:00:00+00:00", "1 day ago"),
        ("2025-03-04T12:00:00+00:00", "365 days ago"),
        ("2027-03-04T12:00:00+00:00", "age not known"),
        ("yesterday", "age not known"),
    ],
)
def test_age(made, words):
    assert age(made, now=datetime(2026, 3, 4, 12, 0, 20, tzinfo=UTC)) == words
