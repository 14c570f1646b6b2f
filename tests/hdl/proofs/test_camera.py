# SPDX-License-Identifier: Apache-2.0
"""The camera's proofs, and that each of them can fail."""

from dataclasses import replace

import pytest
from amaranth.hdl import Const, Module, Signal

from hueflight_hdl.camera import counters
from hueflight_hdl.camera.exposure.frame_guard import FrameGuard
from hueflight_hdl.camera.exposure.time_sync import TimeSync
from hueflight_hdl.camera.formatter import formatter as formatter_module
from hueflight_hdl.camera.formatter.admission import FrameAdmission
from hueflight_hdl.camera.formatter.formatter import FrameFormatter
from hueflight_hdl.camera.formatter.trailer import TrailerWriter
from hueflight_hdl.camera.reduction import core as reduction
from hueflight_hdl.camera.reduction import sum_slice, windows
from hueflight_hdl.camera.reduction.picture_writer import PictureWriter
from hueflight_hdl.camera.reduction.settings import ReductionSettings
from hueflight_hdl.common.counter import SaturatingCounter
from hueflight_hdl.proofs import camera_capture, camera_formatter, camera_reduction, camera_time
from hueflight_hdl.proofs.camera import PROOFS
from hueflight_hdl.proofs.camera_capture import AbortHarness, VerdictHarness
from hueflight_hdl.proofs.camera_counters import CountersHarness
from hueflight_hdl.proofs.camera_formatter import (
    CollisionHarness,
    ProgressHarness,
    StableHarness,
    TrailerHarness,
    WalkHarness,
)
from hueflight_hdl.proofs.camera_time import TimeHarness
from hueflight_hdl.proofs.proof import Proof, ProofError, prove

QUICK = ("camera-stable", "camera-counters", "camera-sums", "camera-time")


@pytest.mark.parametrize("proof", [p for p in PROOFS if p.name in QUICK], ids=lambda p: p.name)
def test_quick(proof, prover):
    prove(proof)


@pytest.mark.slow
@pytest.mark.parametrize("proof", [p for p in PROOFS if p.name not in QUICK], ids=lambda p: p.name)
def test_other(proof, prover):
    prove(proof)


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
        def _buffer(self, m, reader, trailer):
            m.d.comb += [
                self.o.valid.eq(trailer.o.valid),
                self.o.payload.eq(trailer.o.payload),
                reader.room.eq(1),
            ]

    monkeypatch.setattr(camera_formatter, "FrameFormatter", Hasty)
    with pytest.raises(ProofError, match="failed"):
        prove(Proof("", "broken", StableHarness, depth=2))


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["failed", "pin"])
def test_a_time_that_is_not_common_is_found(prover, monkeypatch, fault):
    """A failure of the clock that is not noticed; an edge that comes later at one camera."""

    class Wrong(TimeSync):
        def elaborate(self, platform):
            outside = getattr(self, fault)
            inside = Signal()
            setattr(self, fault, inside)
            m = super().elaborate(platform)
            setattr(self, fault, outside)
            if fault == "pin":
                m.d.sync += [inside.eq(outside), self.zero.eq(self.armed & self.level)]
            return m

    monkeypatch.setattr(camera_time, "TimeSync", Wrong)
    broken(TimeHarness, depth=8)


def broken(harness, *, depth):
    with pytest.raises(ProofError, match="failed"):
        prove(Proof("", "broken", harness, depth=depth, induction=False))


@pytest.mark.slow
def test_a_bank_too_many_is_found(prover, monkeypatch):
    class Generous(FrameAdmission):
        def elaborate(self, platform):
            banks = self.form.banks
            said, self.banks_free = self.banks_free, Signal(range(banks + 2), init=banks + 1)
            m = super().elaborate(platform)
            m.d.comb += said.eq(self.banks_free)
            self.banks_free = said
            return m

    monkeypatch.setattr(formatter_module, "FrameAdmission", Generous)
    broken(CollisionHarness, depth=36)


@pytest.mark.slow
def test_a_walk_with_other_sizes_is_found(prover):
    class Longer(WalkHarness):
        def state(self, m):
            self.form = replace(self.form, code_bits=7)
            super().state(m)

    broken(Longer, depth=26)


@pytest.mark.slow
def test_a_wrong_length_is_found(prover, monkeypatch):
    class Longer(TrailerWriter):
        def elaborate(self, platform):
            m = super().elaborate(platform)
            with m.If(self.o.payload.last):
                m.d.sync += self.o.payload.data[1].eq(1)
            return m

    monkeypatch.setattr(camera_formatter, "TrailerWriter", Longer)
    broken(TrailerHarness, depth=20)


@pytest.mark.slow
def test_too_little_time_is_found(prover):
    class Hasty(ProgressHarness):
        CLOCKS = 24

    broken(Hasty, depth=38)

    class Impatient(AbortHarness):
        CLOCKS = 2

    broken(Impatient, depth=20)


@pytest.mark.slow
def test_a_readout_without_a_verdict_is_found(prover, monkeypatch):
    class Silent(FrameGuard):
        def elaborate(self, platform):
            said, self.dropped = self.dropped, Signal()
            m = super().elaborate(platform)
            self.dropped = said
            return m

    monkeypatch.setattr(camera_capture, "FrameGuard", Silent)
    broken(VerdictHarness, depth=20)


@pytest.mark.slow
def test_a_block_that_is_shown_before_all_is_known_of_it_is_found(prover, monkeypatch):
    monkeypatch.setattr(windows, "SETTLE", 1)
    broken(camera_reduction.WindowsHarness, depth=16)


@pytest.mark.slow
def test_a_block_that_counts_a_frame_twice_is_found(prover, monkeypatch):
    class Twice(windows.BlockWindows):
        def _tell(self, m, first_take, window, since, total):
            super()._tell(m, first_take, window, since - 1, total)

    monkeypatch.setattr(camera_reduction, "BlockWindows", Twice)
    broken(camera_reduction.WindowsHarness, depth=16)


@pytest.mark.slow
def test_a_frame_that_is_too_small_is_found(prover, monkeypatch):
    for module in (reduction, camera_reduction):
        monkeypatch.setattr(module, "LEAST_GROUPS", 5)
    broken(camera_reduction.SumCollisionHarness, depth=14)


@pytest.mark.slow
def test_a_sum_that_wraps_is_found(prover, monkeypatch):
    def wrap(self, platform):
        m = Module()
        m.d.sync += self.after.eq(self.before + self.entry)
        return m

    monkeypatch.setattr(sum_slice.SaturatingSum, "elaborate", wrap)
    proof = next(proof for proof in PROOFS if proof.name == "camera-sums")
    with pytest.raises(ProofError, match="A sum is exact"):
        prove(proof)


@pytest.mark.slow
def test_a_packet_that_does_not_wait_for_room_is_found(prover, monkeypatch):
    class Hasty(PictureWriter):
        def _buffer(self, m, packer, made, making):
            _, empty = super()._buffer(m, packer, made, making)
            return Const(1), empty

    monkeypatch.setattr(camera_reduction, "PictureWriter", Hasty)
    broken(camera_reduction.WriterHarness, depth=70)


@pytest.mark.slow
def test_settings_that_change_as_they_are_taken_over_are_found(prover, monkeypatch):
    class Late(ReductionSettings):
        def elaborate(self, platform):
            m = super().elaborate(platform)
            with m.If(self.began):
                m.d.sync += self.held.eq(self.asked)  # not those that were checked
            return m

    monkeypatch.setattr(camera_reduction, "ReductionSettings", Late)
    broken(camera_reduction.WriterProgressHarness, depth=54)


@pytest.mark.slow
def test_a_capture_that_takes_long_to_end_is_found(prover, monkeypatch):
    monkeypatch.setattr(reduction, "QUIET_CLOCKS", 80)
    broken(camera_reduction.DrainHarness, depth=66)
