# SPDX-License-Identifier: Apache-2.0
"""The client in the documentation, written from its pages alone, does what it says."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

import hueflight as hf
from support.daemon_process import Daemon

SCRIPT = Path(__file__).resolve().parents[3] / "docs" / "examples" / "forty_lines.py"


def test_it_has_forty_lines_of_code() -> None:
    tree = ast.parse(SCRIPT.read_text("utf-8"))
    lines = {node.lineno for node in ast.walk(tree) if isinstance(node, ast.stmt)}
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    assert len(lines) - len(imports) <= 40


@pytest.mark.slow
def test_it_saves_pictures_records_downloads_and_reconstructs(
    start: Callable[..., Daemon], tmp_path: Path
) -> None:
    pytest.importorskip("PIL", reason="pillow is not installed (extra export)")
    from PIL import Image

    daemon = start(tmp_path)
    with hf.connect(daemon.url) as camera:
        camera.start()
        camera.calibrate(distance=0.4, frames=1000, bands=False, timeout_s=240)
        calibration = camera.status()["calibration"]["path"]
    folder = tmp_path / "client"
    folder.mkdir()
    command = [sys.executable, str(SCRIPT), urlsplit(daemon.url).netloc, calibration]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    pictures = sorted(folder.glob("*.png"))
    assert len(pictures) == 3
    assert np.asarray(Image.open(pictures[0])).shape == (24, 16)
    [recording], [store] = folder.glob("*.mcap"), folder.glob("*.zarr")
    with hf.open_recording(recording) as opened:
        assert opened.frames == 480
        wanted = hf.reconstruct(opened.histogram(), hf.Calibration.load(calibration))
    assert np.array_equal(hf.read_image(store).depth, wanted.depth, equal_nan=True)
