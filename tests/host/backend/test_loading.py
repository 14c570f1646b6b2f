# SPDX-License-Identifier: Apache-2.0
"""One place decides which kernels run, and says why."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from hueflight import backend
from hueflight.backend import loading
from hueflight.cli import main
from hueflight.daemon.pictures import live_method
from hueflight.errors import KernelError, SlowKernelsWarning
from hueflight.ingest import numpy_kernels
from hueflight.ingest.kernels import choose

HOST = Path(backend.__file__).parents[1]
compiled = pytest.mark.skipif(
    not all(backend.available(name) for name in backend.KERNELS), reason="not all compiled here"
)


@pytest.fixture
def missing(monkeypatch):
    """No kernel was compiled."""

    def fail(name):
        if "_kernels" in name:
            raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(loading, "import_module", fail)
    for cached in (loading._load, loading._warn_of_slowness):
        cached.cache_clear()
    yield
    for cached in (loading._load, loading._warn_of_slowness):
        cached.cache_clear()


def test_the_environment_is_read_in_one_place():
    readers = [
        path.relative_to(HOST).as_posix()
        for path in HOST.rglob("*.py")
        if re.search(r"environ\W.*(HUEFLIGHT_KERNELS|VARIABLE)", path.read_text("utf-8"))
        or re.search(r"(find_spec|import_module)\(.*_kernels", path.read_text("utf-8"))
    ]
    assert readers == ["backend/loading.py"]


@pytest.mark.parametrize("name", backend.KERNELS)
def test_numpy_on_request(monkeypatch, name):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    assert backend.compiled(name) is None
    assert backend.describe()[name] == "NumPy, since HUEFLIGHT_KERNELS = 'numpy'"


@pytest.mark.parametrize("name", backend.KERNELS)
def test_another_value_is_an_error_that_names_it(monkeypatch, name):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "fortran")
    with pytest.raises(KernelError, match="HUEFLIGHT_KERNELS = 'fortran': must be 'c' or 'numpy'"):
        backend.compiled(name)
    assert backend.describe()[name].startswith("unusable: HUEFLIGHT_KERNELS = 'fortran'")


@compiled
@pytest.mark.parametrize("wish", ["", "c"])
def test_compiled_kernels_run_where_they_are(monkeypatch, wish):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", wish)
    for name, kernel in backend.KERNELS.items():
        module = backend.compiled(name)
        assert module is not None
        assert module.__name__ in kernel.builds
        assert backend.describe()[name] == f"compiled ({module.__name__})"
        assert backend.why_not(name) == ""
    assert choose() is backend.compiled("ingest")


@pytest.mark.usefixtures("missing")
def test_a_process_without_compiled_kernels_is_warned_once(monkeypatch):
    monkeypatch.delenv("HUEFLIGHT_KERNELS", raising=False)
    with pytest.warns(SlowKernelsWarning, match="many times slower") as caught:
        found = [backend.compiled(name) for name in [*backend.KERNELS, *backend.KERNELS]]
    assert not any(found)
    assert len(caught) == 1


@pytest.mark.usefixtures("missing")
def test_who_asks_for_numpy_is_not_warned(monkeypatch):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    assert backend.compiled("fit") is None  # warnings are errors here
    assert backend.compiled("fit", "numpy") is None


@pytest.mark.usefixtures("missing")
@pytest.mark.filterwarnings("default::hueflight.errors.SlowKernelsWarning")
def test_the_command_line_shows_the_warning_as_a_sentence(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("HUEFLIGHT_KERNELS", raising=False)
    path = tmp_path / "one.mcap"
    with pytest.raises(SystemExit):
        main(["simulate", "fig1", "--frames", "1", "-o", str(path)])
    with pytest.raises(SystemExit):
        main(["info", str(path), "--check"])
    said = capsys.readouterr().err
    assert said.count("warning: Hueflight was installed without its compiled kernels") == 1
    assert "UserWarning" not in said
    assert "loading.py" not in said


@pytest.mark.usefixtures("missing")
@pytest.mark.filterwarnings("ignore::hueflight.errors.SlowKernelsWarning")
def test_numpy_where_nothing_was_compiled(monkeypatch):
    monkeypatch.delenv("HUEFLIGHT_KERNELS", raising=False)
    for name, kernel in backend.KERNELS.items():
        assert backend.compiled(name) is None
        assert not backend.available(name)
        assert backend.describe()[name].startswith(f"NumPy, since {kernel.builds[-1]} was not")
    assert choose() is numpy_kernels


@pytest.mark.usefixtures("missing")
def test_who_insists_on_compiled_kernels_is_told_that_there_are_none(monkeypatch):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "c")
    for name in backend.KERNELS:
        with pytest.raises(KernelError, match=r"= 'c', but .* was not compiled"):
            backend.compiled(name)


@pytest.mark.parametrize(("faster", "expected"), [(0, ""), (1, "_v3"), (2, "_v4")])
def test_the_fastest_build_that_the_processor_runs(monkeypatch, faster, expected):
    def load(name):
        abi = backend.KERNELS["fit"].interface.hash
        return SimpleNamespace(__name__=name, processor=lambda: faster, ABI=abi)

    monkeypatch.setattr(loading, "import_module", load)
    loading._load.cache_clear()
    module = backend.compiled("fit", "c")
    loading._load.cache_clear()
    assert module is not None
    assert module.__name__ == f"hueflight.fit._kernels{expected}"


@compiled
def test_live_pictures_take_the_joint_fit_only_where_the_compiled_one_runs(monkeypatch):
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "c")
    assert live_method() == "joint"
    monkeypatch.setenv("HUEFLIGHT_KERNELS", "numpy")
    assert live_method() == "paper"
