# SPDX-License-Identifier: Apache-2.0
"""The archive and the wheels of a release: complete, and enough for a first picture."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = [sys.executable, str(ROOT / "tools" / "packages.py")]
NOT_RELEASED = (".github/", ".ci/", ".gitignore", "docs/.gitignore", ".pre-commit")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(2400),  # two builds of all kernels, and environments with all packages
    pytest.mark.skipif(sys.platform != "linux", reason="wheels are built for Linux"),
]


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the archive and the wheel for this processor."""
    folder = tmp_path_factory.mktemp("release")
    subprocess.run([*PACKAGES, "--out", str(folder)], check=True, cwd=folder)
    return folder


def only(folder: Path, pattern: str) -> Path:
    (found,) = folder.glob(pattern)
    return found


def pythons() -> list[str]:
    """Interpreters of other versions that this machine has, beside the one that runs the tests."""
    found = {sys.version_info[1]: sys.executable}
    places = [*map(Path, os.get_exec_path()), *Path.home().glob(".pyenv/versions/3.1*/bin")]
    for minor in range(12, 15):
        for place in places:
            program = place / f"python3.{minor}"
            if minor not in found and program.exists() and runs(program):
                found[minor] = str(program)
    return list(found.values())


def runs(program: Path) -> bool:
    """Whether it is an interpreter that can make environments, not a shim for one."""
    done = subprocess.run([program, "-c", "import venv, ssl"], capture_output=True, check=False)
    return done.returncode == 0


def install(folder: Path, what: str, *, python: str = sys.executable, **settings: str) -> Path:
    """Install into a new environment and return the folder of its programs."""
    subprocess.run([python, "-m", "venv", str(folder)], check=True)
    pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", "--no-cache-dir"]
    constraints = ["-c", str(ROOT / "constraints.txt")] if python == sys.executable else []
    subprocess.run([*pip, *constraints, what], check=True, env=clean(**settings))
    return folder / "bin"


def clean(**settings: str) -> dict[str, str]:
    """This process's environment without what would import the checkout instead."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return kept | settings


def hueflight(programs: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [programs / "hueflight", *words],
        cwd=folder,
        env=clean(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def said_of_kernels(programs: Path, folder: Path) -> str:
    """What `--version` says, on one line."""
    return " ".join(hueflight(programs, folder, "--version").stdout.split())


def first_picture(programs: Path, folder: Path) -> str:
    """Take the README's way from nothing to a picture; return what was said on the way."""
    steps = (
        "simulate --capture reference --distance 0.4 --frames 1000 -o reference.npz",
        "simulate fig1 --frames 200 -o scene.mcap",
        "info scene.mcap --check",
        "calibrate reference.npz --distance 0.4 -o my.zarr",
        "reconstruct scene.mcap -c my.zarr --method paper -o scene.zarr",
        "view scene.zarr -o scene.html",
    )
    said = [hueflight(programs, folder, *step.split()).stderr for step in steps]
    page = (folder / "scene.html").read_text(encoding="utf-8")
    assert len(page) > 100_000  # the page holds the picture
    return "".join(said)


def test_the_archive_holds_all_that_is_tracked(release: Path) -> None:
    done = subprocess.run(
        ["git", "-C", ROOT, "ls-files"], stdout=subprocess.PIPE, text=True, check=False
    )
    if done.returncode:
        pytest.skip("not a clone: git does not know the files")
    expected = {name for name in done.stdout.split() if not name.startswith(NOT_RELEASED)}
    with tarfile.open(only(release, "*.tar.gz")) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert sorted(expected - names) == []
    assert not [name for name in names if name.endswith((".so", ".pyc"))]


def test_the_wheel_serves_every_later_python_on_old_systems(release: Path) -> None:
    wheel = only(release, "*.whl")
    assert "-cp311-abi3-" in wheel.name
    assert "manylinux_2_17" in wheel.name
    names = ZipFile(wheel).namelist()
    packages = {name.partition("/")[0] for name in names if ".dist-info" not in name}
    assert packages == {"hueflight", "hueflight_hdl", "hueflight_protocol"}
    assert any(name.endswith("licenses/LICENSE") for name in names)


@pytest.mark.parametrize("python", pythons())
def test_the_wheel_alone_ends_with_a_picture(release: Path, tmp_path: Path, python: str) -> None:
    programs = install(tmp_path / "venv", str(only(release, "*.whl")), python=python)
    said = said_of_kernels(programs, tmp_path)
    assert said.count(": compiled") == said.count("kernels for ") > 0
    assert "warning" not in first_picture(programs, tmp_path)


def test_the_archive_without_a_compiler_ends_with_a_picture(release: Path, tmp_path: Path) -> None:
    archive = str(only(release, "*.tar.gz"))
    programs = install(tmp_path / "venv", archive, CC="/bin/false")
    said = said_of_kernels(programs, tmp_path)
    assert said.count("was not compiled") == said.count("kernels for ") > 0
    assert "installed without its compiled kernels" in first_picture(programs, tmp_path)


def test_a_git_address_ends_with_a_picture(tmp_path: Path) -> None:
    programs = install(tmp_path / "venv", f"git+{ROOT.as_uri()}")
    first_picture(programs, tmp_path)


def test_a_release_is_refused_where_a_kernel_does_not_compile(tmp_path: Path) -> None:
    done = subprocess.run(
        [*PACKAGES, "--out", str(tmp_path)],
        env=os.environ | {"CC": "/bin/false"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert not [*tmp_path.glob("*.whl")]
