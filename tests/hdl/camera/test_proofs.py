"""The camera's proofs, and that each of them can fail."""

import pytest
from amaranth.hdl import Module

from hueflight_hdl.counter import SaturatingCounter
from hueflight_hdl.frame import counters
from hueflight_hdl.frame import formatter as formatter_module
from hueflight_hdl.frame.formatter import FrameFormatter
from hueflight_hdl.frame.front import FrameFront
from hueflight_hdl.proofs import camera_formatter
from hueflight_hdl.proofs.camera import PROOFS, main
from hueflight_hdl.proofs.camera_counters import CountersHarness
from hueflight_hdl.proofs.camera_formatter import CollisionHarness, StableHarness
from hueflight_hdl.proofs.proof import Proof, ProofError, prove

QUICK = ("camera-stable", "camera-counters")


@pytest.mark.parametrize("proof", [p for p in PROOFS if p.name in QUICK], ids=lambda p: p.name)
def test_quick(proof, prover):
    prove(proof)


@pytest.mark.slow
@pytest.mark.parametrize("proof", [p for p in PROOFS if p.name not in QUICK], ids=lambda p: p.name)
def test_other(proof, prover):
    prove(proof)


def test_unknown_names_are_refused():
    with pytest.raises(ProofError, match="camera-nothing: there are camera-stable"):
        main(["camera-nothing"])


@pytest.mark.slow
def test_a_counter_that_wraps_is_found(prover, monkeypatch):
    class Wrapping(SaturatingCounter):
        def elaborate(self, platform):
            m = Module()
            m.d.sync += self.value.eq(self.value + self.event)
            with m.If(self.clear):
                m.d.sync += self.value.eq(0)
            return m

    monkeypatch.setattr(counters, "SaturatingCounter", Wrapping)
    with pytest.raises(ProofError, match="failed"):
        prove(Proof("", "broken", CountersHarness, depth=2))


@pytest.mark.slow
def test_a_link_that_is_not_waited_for_is_found(prover, monkeypatch):
    class Hasty(FrameFormatter):
        def _buffer(self, m, reader, sealer):
            m.d.comb += [
                self.o.valid.eq(sealer.o.valid),
                self.o.payload.eq(sealer.o.payload),
                reader.room.eq(1),
            ]

    monkeypatch.setattr(camera_formatter, "FrameFormatter", Hasty)
    with pytest.raises(ProofError, match="failed"):
        prove(Proof("", "broken", StableHarness, depth=2))


@pytest.mark.slow
def test_a_bank_too_many_is_found(prover, monkeypatch):
    class Generous(FrameFront):
        def __init__(self, form):
            super().__init__(form)
            self.banks_free.init = form.banks + 1

    monkeypatch.setattr(formatter_module, "FrameFront", Generous)
    with pytest.raises(ProofError, match="failed"):
        prove(Proof("", "broken", CollisionHarness, depth=36, induction=False))
