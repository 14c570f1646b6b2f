# SPDX-License-Identifier: Apache-2.0
"""`hueflight view` of images, counts and both."""

import numpy as np
import pytest

import hueflight as hf
from hueflight.cli import main
from hueflight.export import describe, write
from hueflight.importers.captures import write_counts


def run(*words) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return ended.value.code or 0


@pytest.fixture
def folder(tmp_path, monkeypatch, small, draw):
    monkeypatch.chdir(tmp_path)
    camera = small(rows=4, cols=5)
    calibration = hf.calibrate(draw(camera, depth=0.4, photons=20_000), camera, distance=0.4)
    calibration.save("cal.zarr")
    counts = draw(camera, depth=0.6, photons=2000, seed=1)
    write_counts(tmp_path / "scene.npz", counts, camera)
    np.save("bare.npy", counts)
    write(describe(hf.reconstruct(counts, calibration), calibration), "scene.zarr")
    return tmp_path


def test_every_kind_of_input(folder, capsys):
    assert run("view", "scene.zarr", "--no-open") == 0
    alone = (folder / "scene.html").read_text()
    assert '"model": null' in alone
    assert run("view", "scene.zarr", "--no-open") == 1
    assert "scene.html" in capsys.readouterr().err
    both = ["scene.zarr", "--capture", "scene.npz", "-c", "cal.zarr", "-o", "both.html"]
    assert run("view", *both, "--no-open") == 0
    assert '"templates"' in (folder / "both.html").read_text()
    assert run("view", "bare.npy", "-c", "cal.zarr", "--no-open") == 0
    assert '"templates"' in (folder / "bare.html").read_text()
    assert run("view", "scene.npz", "-o", "counts.html", "--no-open") == 0
    assert '"Depth"' not in (folder / "counts.html").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.zarr"], "none.zarr"),
        (["bare.npy"], "instrument"),
        (["scene.npz", "-o", "page.png"], "NAME.html"),
        (["cal.zarr"], "cal.zarr"),
    ],
)
def test_what_can_not_be_shown_is_said(folder, words, message, capsys):
    assert run("view", *words, "--no-open") == 1
    assert message in capsys.readouterr().err
