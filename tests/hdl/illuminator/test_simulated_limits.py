# SPDX-License-Identifier: Apache-2.0
"""The simulated rig refuses the schedules that an illuminator as it is built by default refuses."""

from hueflight.emulation.simulated_rig import USUAL_LIMIT
from hueflight_hdl.illuminator.pulse_generator.config import Limits


def test_the_usual_limit_is_that_of_the_gateware() -> None:
    built = Limits()
    assert (USUAL_LIMIT.on_ticks, USUAL_LIMIT.burst_ticks, USUAL_LIMIT.duty_divisor) == (
        built.max_on_ticks, built.burst_ticks, built.duty_divisor,
    )  # fmt: skip
