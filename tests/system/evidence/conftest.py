# SPDX-License-Identifier: Apache-2.0
"""The measurements of tools/evidence as modules, in their small forms."""

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

TOOLS = Path(__file__).resolve().parents[3] / "tools" / "evidence"


@pytest.fixture
def evidence(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Function: a module of tools/evidence by name."""
    monkeypatch.syspath_prepend(str(TOOLS))
    yield import_module
    for name in [path.stem for path in TOOLS.glob("[!_]*.py")]:
        sys.modules.pop(name, None)
