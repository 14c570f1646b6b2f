# SPDX-License-Identifier: Apache-2.0
"""The tutorials of other programs are executed as they stand, and leave the pictures they show.

With ``HUEFLIGHT_PICTURES=docs/images`` in the environment, the pictures are kept there.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from support.daemon_process import Daemon
from support.small_daemon import small_daemon

ROOT = Path(__file__).resolve().parents[3]
ADDRESS = "localhost:8470"  #: in the pages; the test's daemon has a port of its own
PAGES = {"napari": "napari", "micro-manager": "pymmcore_plus", "bluesky": "ophyd_async"}


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    """What the pages start: a simulated camera, which brings its calibration."""
    folder = tmp_path_factory.mktemp("tutorials")
    started = small_daemon(folder, ROOT / "docs" / "tutorials" / "small.toml")
    try:
        with hf.connect(started.url) as camera:
            camera.start()
            next(picture for picture in camera.pictures(timeout_s=240) if "depth" in picture)
        yield started
    finally:
        started.end()


@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_runs_as_it_stands(page: str, daemon: Daemon, tmp_path: Path) -> None:
    pytest.importorskip(PAGES[page], reason=f"other programs are not installed: extra {page!r}")
    screen: list[str] = []
    if page == "napari":  # what it draws needs OpenGL, which Qt has only on a screen
        if shutil.which("xvfb-run") is None:
            pytest.skip("xvfb is not installed")
        screen = ["xvfb-run", "-a", "-s", "-screen 0 1280x960x24"]
    code = code_of(page)
    assert ADDRESS in code
    run(page, code.replace(ADDRESS, daemon.url), tmp_path, screen)


def test_npy_files_become_a_cloud_in_open3d(tmp_path: Path) -> None:
    """Distances and reflectance of the steps are those of the scene."""
    pytest.importorskip("open3d", reason="other programs are not installed: open3d")
    told = run("open3d", code_of("open3d"), tmp_path)
    steps = re.findall(r"^step of \d+ points at (.+) ± (.+) m, .* reflectance (.+)$", told, re.M)
    depth, stated, infrared = np.array(sorted(steps), dtype=float).T
    assert np.all(np.abs(depth - np.linspace(0.6, 1.3, 8)) < 3 * stated)
    np.testing.assert_allclose(infrared, 0.8, atol=0.03)  # of the scene
    used = {name: int(size) for name, size in re.findall(r"^(\w+): (\d+) MB$", told, re.M)}
    assert set(used) == {"commands", "Open3D"}
    assert max(used.values()) < 1500, "MB"


def code_of(page: str) -> str:
    """The blocks of a page as one program; those for a shell are given to bash."""
    text = (ROOT / "docs" / "tutorials" / f"{page}.md").read_text("utf-8")
    parts = []
    for language, code in re.findall(r"^```(python|bash)\n(.*?)^```$", text, flags=re.M | re.S):
        call = f"__import__('subprocess').run(['bash', '-ec', {code!r}], check=True)\n"
        parts.append(code if language == "python" else call)
    return "\n".join(parts)


def run(page: str, code: str, folder: Path, screen: Sequence[str] = ()) -> str:
    """Run a page's program, keep its picture, and return what it printed."""
    script = folder / "tutorial.py"
    script.write_text(code, "utf-8")
    search = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        [*screen, sys.executable, str(script)],
        cwd=folder, capture_output=True, text=True, timeout=240, check=False,
        env=os.environ | {"PATH": search, "QT_QPA_PLATFORM": "xcb" if screen else "offscreen"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr[-4000:]
    picture = folder / f"{page}.png"
    assert picture.stat().st_size > 4000
    if kept := os.environ.get("HUEFLIGHT_PICTURES"):
        shutil.copy(picture, ROOT / kept)
    return done.stdout
