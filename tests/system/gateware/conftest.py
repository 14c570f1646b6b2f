# SPDX-License-Identifier: Apache-2.0
"""The tools that compile gateware, or a reason to skip."""

import pytest

from hueflight_hdl.toolchain import find_tool


@pytest.fixture(scope="session")
def compiler():
    """Designs can be compiled for simulation."""
    missing = [tool for tool in ("yosys", "c++") if find_tool(tool) is None]
    if missing:
        pytest.skip(f"{' and '.join(missing)} not found: no compiled simulation of gateware")
