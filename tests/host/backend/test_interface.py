# SPDX-License-Identifier: Apache-2.0
"""C and Python of the kernels have one declaration, and a stale build is refused."""

import inspect
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import hueflight as hf
from hueflight import backend
from hueflight.backend import interface, loading
from hueflight.backend.fit import FIT, TABLE_SIZES
from hueflight.backend.ingest import COUNT, SCAN
from hueflight.errors import KernelError
from hueflight.ingest import numpy_kernels

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools"))
headers = import_module("generate_kernel_headers").headers


@pytest.mark.parametrize("path", headers(), ids=lambda path: path.parts[-3])
def test_headers_are_what_the_declarations_give(path):
    assert path.read_text("utf-8") == headers()[path], "run tools/generate_kernel_headers.py"


@pytest.fixture
def stale(monkeypatch):
    """Every module that is there was built from another declaration."""
    load = loading.import_module

    def load_stale(name):
        module = load(name)
        if not name.rpartition(".")[2].startswith("_kernels"):
            return module
        names = {name: getattr(module, name) for name in dir(module)}
        return SimpleNamespace(**names | {"ABI": "0123456789abcdef"})

    monkeypatch.setattr(loading, "import_module", load_stale)
    loading._load.cache_clear()
    yield
    loading._load.cache_clear()


@pytest.mark.usefixtures("stale")
@pytest.mark.parametrize("name", backend.KERNELS)
@pytest.mark.parametrize("wish", ["", "c"])
def test_a_stale_build_is_an_error(monkeypatch, name, wish):
    if backend.why_not(name) and "not compiled" in backend.why_not(name):
        pytest.skip(backend.why_not(name))
    monkeypatch.setenv("HUEFLIGHT_KERNELS", wish)
    with pytest.raises(KernelError, match=r"interface 0123456789abcdef.*install the package again"):
        backend.compiled(name)
    assert backend.describe()[name].startswith("unusable: ")
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    assert backend.compiled(name) is None


@pytest.mark.usefixtures("stale", "compiled_module")
@pytest.mark.parametrize("method", ["joint", "paper", "pooled"])
def test_no_image_comes_from_a_stale_build(monkeypatch, small, draw, method):
    instrument = small(rows=4, cols=4)
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    monkeypatch.delenv("HUEFLIGHT_KERNELS")
    with pytest.raises(KernelError, match="built from other sources"):
        hf.reconstruct(draw(instrument, photons=600), calibration, method=method)


@pytest.fixture
def compiled_module():
    """The fit was compiled, or the test is skipped."""
    pytest.importorskip("hueflight.fit._kernels")


@pytest.mark.parametrize("kernel", backend.KERNELS.values(), ids=lambda kernel: kernel.name)
def test_the_hash_depends_on_every_declaration(kernel):
    whole = kernel.interface
    fewer = [
        interface.Interface(whole.name, whole.constants[1:], whole.records, whole.functions),
        interface.Interface(whole.name, whole.constants, whole.records[1:], whole.functions),
        interface.Interface(whole.name, whole.constants, whole.records, whole.functions[1:]),
        interface.Interface(whole.name, whole.constants, whole.records, whole.functions[::-1]),
    ]
    different = 5 if len(whole.functions) > 1 else 4  # one function has one order
    assert len({whole.hash, *(other.hash for other in fewer)}) == different


@pytest.mark.parametrize("declared", [SCAN, COUNT], ids=lambda function: function.name)
def test_numpy_definitions_take_the_declared_arguments(declared):
    parameters = inspect.signature(getattr(numpy_kernels, declared.name)).parameters
    assert list(parameters) == [name for name, _ in declared.parameters]


def test_records_need_every_field():
    values = dict.fromkeys(TABLE_SIZES.names, 1)
    assert TABLE_SIZES.pack(**values)["lag_ns"] == 1
    with pytest.raises(TypeError, match="unknown fields: color"):
        TABLE_SIZES.pack(**values, color=3)
    del values["lags"]
    with pytest.raises(TypeError, match="missing or unknown fields: lags"):
        TABLE_SIZES.pack(**values)


def test_arguments_are_checked_by_name_and_type():
    nothing = {buffer.name: np.empty(0) for buffer in FIT.buffers}
    with pytest.raises(TypeError, match="fit: pixels is float64, expected int64"):
        FIT.arguments(**nothing)
    del nothing["rates"]
    with pytest.raises(TypeError, match="missing or unknown arguments: rates"):
        FIT.arguments(**nothing)


def test_every_header_of_a_kernel_is_among_what_its_build_depends_on(monkeypatch):
    made = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("setuptools.setup", lambda **options: made.update(options))
    exec(compile((ROOT / "setup.py").read_text("utf-8"), "setup.py", "exec"), {})
    for extension in made["ext_modules"]:
        depends = {Path(path).resolve() for path in extension.depends}
        pending = [Path(source) for source in extension.sources]
        seen = set()
        while pending:
            path = pending.pop()
            for name in re.findall(r'^\s*#\s*include "(.+?)"', path.read_text("utf-8"), re.M):
                folders = [path.parent, *map(Path, extension.include_dirs)]
                header = next(f / name for f in folders if (f / name).exists()).resolve()
                assert header in depends, f"{extension.name}: {path.name} includes {name}"
                if header not in seen:
                    seen.add(header)
                    pending.append(header)
        assert seen


def test_the_command_that_builds_kernels_in_place_can_read_the_project():
    """As CONTRIBUTING names it; an older setuptools refuses the form of the licence."""
    command = [sys.executable, "setup.py", "--quiet", "--name"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == "hueflight"
