# SPDX-License-Identifier: Apache-2.0
"""Properties of the illuminator hold, and false variants of each are rejected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from amaranth.hdl import Module, Signal

from hueflight_hdl.boards.reference_clock import ReferenceSupervisor
from hueflight_hdl.illuminator.arming import Arming
from hueflight_hdl.illuminator.pulse_generator.generator import PulseGenerator
from hueflight_hdl.illuminator.pulse_generator.limiter import OutputLimiter
from hueflight_hdl.proofs import illuminator_banks, illuminator_requests, illuminator_safety
from hueflight_hdl.proofs.illuminator import PROOFS
from hueflight_hdl.proofs.illuminator_banks import OtherBankHarness
from hueflight_hdl.proofs.illuminator_filter import FilterHarness
from hueflight_hdl.proofs.illuminator_limits import LimiterHarness
from hueflight_hdl.proofs.proof import ProofError, prove

BY_NAME = {proof.name: proof for proof in PROOFS}
QUICK = {"illuminator-dark", "illuminator-reference"}


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in BY_NAME],
)
def test_proof(prover: None, name: str):
    prove(BY_NAME[name])


def less(part: str, **limits: int) -> Callable[[pytest.MonkeyPatch], str]:
    """State a stricter limit than the limiter is built for."""

    def falsify(patch: pytest.MonkeyPatch) -> str:
        initialise = LimiterHarness.__init__

        def stricter(self: LimiterHarness, *args: object, **options: object) -> None:
            initialise(self, *args, **options)
            self.limits = replace(self.limits, **limits)

        patch.setattr(LimiterHarness, "__init__", stricter)
        return part

    return falsify


def set_to(name: str, target: object, attribute: str, value: object):
    def falsify(patch: pytest.MonkeyPatch) -> str:
        patch.setattr(target, attribute, value)
        return name

    return falsify


class DeafArming(Arming):
    """Arms whatever the clock does."""

    def elaborate(self, platform: object) -> Module:
        self.disarm = Signal()
        return super().elaborate(platform)


FALSE = {
    "dark a clock too soon": set_to("illuminator-dark", PulseGenerator, "armed_latency", 1),
    "another key": set_to("illuminator-watchdog", illuminator_safety, "ARM_KEY", 5),
    "armed while the clock fails": set_to(
        "illuminator-watchdog", illuminator_safety, "Arming", DeafArming
    ),
    "on-time one tick less": less("illuminator-on-time-4", max_on_ticks=79),
    "duty one tick less": less("illuminator-duty-4", burst_ticks=79),
    "a limiter that forgets parts of clocks": set_to(
        "illuminator-duty-4", OutputLimiter, "threshold", 8 * 80
    ),
    "a filter one tick wider": set_to("illuminator-filter-4", FilterHarness, "spare", 1),
    "trains farther apart": set_to("illuminator-bank", illuminator_banks, "MIN_SPACING", 9),
    "a bank let go at once": set_to("illuminator-other-bank", OtherBankHarness, "HELD_CLOCKS", 1),
    "a lost clock let go sooner": set_to(
        "illuminator-reference", ReferenceSupervisor, "latency", 6
    ),
    "answered sooner": set_to("illuminator-answers", illuminator_requests, "LONGEST", 3000),
}


@pytest.mark.parametrize(
    "what",
    [pytest.param(w, marks=() if w.startswith("dark") else pytest.mark.slow) for w in FALSE],
)
def test_false_variants_are_rejected(prover: None, what: str, monkeypatch: pytest.MonkeyPatch):
    name = FALSE[what](monkeypatch)
    with pytest.raises(ProofError, match="not verified"):
        prove(BY_NAME[name])
