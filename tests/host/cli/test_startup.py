# SPDX-License-Identifier: Apache-2.0
"""Quick commands load only what they need. No test on time: `tools/bench/startup.py` measures."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import hueflight as hf
from hueflight import simulator
from hueflight.recording import RecordingWriter

#: packages that take long to load and that quick commands have no use for
SLOW = ("scipy", "xarray", "pandas", "zarr", "matplotlib", "dask", "distributed", "starlette")
#: our packages that load them
RECONSTRUCTION = ("hueflight.calibration", "hueflight.simulator", "hueflight.batch")

PROGRAM = """
import sys
{code}
print("loaded:", *sorted(sys.modules))
"""
COMMAND = """
from hueflight.cli import main
try:
    main({words!r})
except SystemExit as stop:
    assert not stop.code, stop.code
"""


def loaded_by(code: str) -> set[str]:
    """Names of all modules that a fresh interpreter has loaded after it ran the code."""
    finished = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(code=code)],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return set(finished.stdout.rpartition("loaded: ")[2].split())


def require_light(modules: set[str]) -> None:
    assert not modules & {*SLOW, *RECONSTRUCTION}
    assert any(name.startswith("hueflight") for name in modules)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, small) -> Path:
    instrument = small(rows=4, cols=4)
    path = tmp_path_factory.mktemp("startup") / "scene.mcap"
    with RecordingWriter(path, instrument) as writer:
        for packet in simulator.simulate_packets("reference", instrument, frames=3):
            writer.write(packet)
    return path


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["info", "--help"]])
def test_version_and_help_load_no_reconstruction(words: list[str]) -> None:
    require_light(loaded_by(COMMAND.format(words=words)))


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_info_loads_no_reconstruction(recording: Path, options: list[str]) -> None:
    modules = loaded_by(COMMAND.format(words=["info", str(recording), *options]))
    require_light(modules)
    assert "hueflight.recording.reader" in modules


def test_importing_the_package_loads_nothing_else() -> None:
    modules = loaded_by("import hueflight")
    require_light(modules)
    assert "numpy" not in modules
    assert {name for name in modules if name.startswith("hueflight.")} == {"hueflight.lazy"}


@pytest.mark.parametrize("package", ["fit", "reconstruction"])
def test_importing_a_lazy_package_loads_none_of_its_modules(package: str) -> None:
    modules = loaded_by(f"import hueflight.{package}")
    require_light(modules)
    ours = {name for name in modules if name.startswith("hueflight.")}
    assert ours == {"hueflight.lazy", f"hueflight.{package}"}


def test_a_public_name_loads_what_it_needs() -> None:
    modules = loaded_by("import hueflight as hf\nhf.Instrument")
    require_light(modules)
    assert "hueflight.model.instrument" in modules
    assert hf.Instrument.__module__ == "hueflight.model.instrument"
