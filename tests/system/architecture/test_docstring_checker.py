# SPDX-License-Identifier: Apache-2.0
"""The docstring checker looks at the right objects."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
SIMULATOR = ROOT / "host" / "hueflight" / "simulator"


def test_a_function_with_the_name_of_a_module_does_not_hide_its_classes():
    """`hueflight.simulator` exports a function `scene`, which is also the name of a module."""
    command = [sys.executable, ROOT / "tools" / "check_docstrings.py", SIMULATOR / "scene.py"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout == "0 findings\n"
