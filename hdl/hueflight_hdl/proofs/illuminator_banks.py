# SPDX-License-Identifier: Apache-2.0
"""A train uses one bank throughout; the content of the other bank does not affect it."""

from __future__ import annotations

from amaranth.hdl import Assert, Assume, DomainRenamer, Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In

from ..illuminator.pulse_generator.config import MIN_SPACING, PERIOD_BITS, Limits, PulseConfig
from ..illuminator.pulse_generator.slot import PulseSlot
from ..illuminator.pulse_generator.train import Train
from .harness import FreeHarness


class TrainHarness(FreeHarness):
    """Trains with any triggers, periods, and wishes for bank, mask and marker in every clock."""

    def __init__(self) -> None:
        self.config = PulseConfig(channels=2)
        self.train = Train(self.config)
        super().__init__(self.train)

    def state(self, m: Module) -> None:
        """Compare each train with the one before."""
        train = self.train
        # periods are at rest
        begun = Signal()
        periods = Signal.like(self.periods)
        m.d.sync += [begun.eq(1), periods.eq(self.periods)]
        with m.If(begun):
            m.d.comb += Assume(periods.as_value() == self.periods.as_value())

        # what a train is of changes only in the first clock of one that was served
        fired = Signal()  # some train has been served
        served = Signal()
        m.d.sync += served.eq(train.served)
        for what in (train.train.bank, train.train.phase, train.mask_out, train.marker_out):
            before = Signal(len(what))
            m.d.sync += before.eq(what)
            with m.If(before != what):
                m.d.comb += [Assert(served), Assert(train.train.time == 0)]

        # and that comes no sooner than the period allows
        whole = Mux(self.bank, self.periods[1], self.periods[0])[self.config.lane_bits :]
        length = Signal(PERIOD_BITS)
        age = Signal(PERIOD_BITS)  # clocks since the last one was served
        m.d.sync += age.eq(Mux(train.served, 1, Mux(age.all(), age, age + 1)))
        with m.If(train.served):
            m.d.sync += [fired.eq(1), length.eq(Mux(whole < MIN_SPACING, MIN_SPACING, whole))]
        with m.If(train.served & fired):
            m.d.comb += Assert(age >= MIN_SPACING)
            with m.If(~train.restarted):
                m.d.comb += Assert(age >= length)
        # what the induction needs: the train knows what is left of it
        with m.If(train.busy & ~train.served):
            left = Mux(train.loads, train.length + 1, train.left)
            m.d.comb += [
                Assert(fired),
                Assert(train.loads == (age == 1)),
                Assert(age + left == length),
            ]
        with m.If(fired):
            m.d.comb += Assert(length >= MIN_SPACING)
            with m.If(~train.busy):
                m.d.comb += Assert(age >= length - 1)


class OtherBankHarness(wiring.Component):
    """Two pulses with the same train; the bank that is not in use differs, and changes at will.

    The bank of the train must be at rest from the train's first clock until its last pulse has
    begun; that of the train before it, as long as a pulse can be between delay and width.
    """

    config = PulseConfig(channels=1, pulses=1, limits=Limits(max_on_ticks=20, burst_ticks=80))
    HELD_CLOCKS = 6

    def __init__(self) -> None:
        layout = data.ArrayLayout(self.config.pulse_layout, 2)
        super().__init__(
            {
                "train": In(self.config.train_layout),
                "lit": In(1),
                "settings": In(layout),
                "others": In(layout),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        slots = [PulseSlot(self.config) for _ in range(2)]
        kept = Signal.like(self.settings)
        begun = Signal()
        m.d.sync += [begun.eq(1), kept.eq(self.settings)]
        with m.If(begun):
            m.d.comb += Assume(kept.as_value() == self.settings.as_value())
        for number, slot in enumerate(slots):
            m.submodules[f"slot{number}"] = DomainRenamer({"pulse": "sync"})(slot)
            m.d.comb += [slot.train.eq(self.train), slot.lit.eq(self.lit)]
        for bank in range(2):
            used = Signal(self.HELD_CLOCKS, name=f"used{bank}")
            now = self.train.bank == bank
            m.d.sync += used.eq(used << 1 | now)
            m.d.comb += [
                slots[0].settings[bank].eq(self.settings[bank]),
                slots[1]
                .settings[bank]
                .eq(Mux(now | used.any(), self.settings[bank], self.others[bank])),
            ]
        m.d.comb += Assert(slots[0].level == slots[1].level)
        return m
