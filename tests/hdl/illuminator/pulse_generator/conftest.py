# SPDX-License-Identifier: Apache-2.0
"""Compiled pulse generators, kept for all tests of a worker."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hueflight_hdl.illuminator.pulse_generator.config import PulseConfig
from hueflight_hdl.testbench.pulse_generator import PulseTestbench


@pytest.fixture(scope="session")
def bench(simulator: None) -> Callable[[PulseConfig], PulseTestbench]:
    """A bench for a configuration, compiled once."""
    benches: dict[PulseConfig, PulseTestbench] = {}

    def make(config: PulseConfig) -> PulseTestbench:
        if config not in benches:
            benches[config] = PulseTestbench(config)
        return benches[config]

    return make
