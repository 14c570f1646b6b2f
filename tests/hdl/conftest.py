# SPDX-License-Identifier: Apache-2.0
"""Fixtures that skip a test where the tools that it needs are not installed."""

from __future__ import annotations

import pytest

from hueflight_hdl.toolchain import find_tool


def need_tools(*tools: str) -> None:
    """Skip where a tool is absent."""
    missing = [tool for tool in tools if find_tool(tool) is None]
    if missing:
        pytest.skip(f"{' and '.join(missing)} not found: see hueflight_hdl.toolchain")


@pytest.fixture(scope="session")
def simulator() -> None:
    """Designs can be compiled for simulation."""
    need_tools("yosys", "c++")


@pytest.fixture(scope="session")
def prover() -> None:
    """Properties can be verified formally."""
    need_tools("yosys", "sby", "smtbmc", "yices")


@pytest.fixture(scope="session")
def builder() -> None:
    """Bitstreams can be built."""
    need_tools("yosys", "nextpnr-ice40", "icepack", "nextpnr-ecp5", "ecppack")


@pytest.fixture(scope="session")
def verilator() -> None:
    """Whole boards can be simulated."""
    need_tools("yosys", "verilator", "c++")
