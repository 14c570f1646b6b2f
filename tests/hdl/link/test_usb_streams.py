# SPDX-License-Identifier: Apache-2.0
"""The seam between the camera and bulk endpoints, and the pins of the FT601, clock by clock."""

import numpy as np
import pytest
from amaranth.hdl import ClockDomain, Elaboratable, Module
from amaranth.sim import Simulator

from hueflight_hdl.link.ft601 import LINGER_CLOCKS, Ft601Bursts, Ft601Link
from hueflight_hdl.link.packet_crossing import PacketCrossing
from hueflight_hdl.link.usb_streams import PACKET_BYTES, ControlBytes, PacketBytes


def run(dut, *processes, domains):
    simulator = Simulator(dut)
    for domain, period in domains.items():
        simulator.add_clock(period, domain=domain)
    *others, last = processes
    for process in others:
        simulator.add_testbench(process, background=True)
    simulator.add_testbench(last)
    simulator.run()


@pytest.mark.parametrize("pause", [0.0, 0.3])
def test_bytes_of_packets_in_order_and_a_transfer_ends_only_where_nothing_follows(pause):
    linger = 20
    rng = np.random.default_rng(1)
    # packets of 1 to 5 words: (words, clocks of silence after it)
    packets = [(rng.bytes(8 * rng.integers(1, 6)), gap) for gap in (0, 3, 10, 60, 0, 200, 5, 90)]
    expected_ends = [index for index, (_, gap) in enumerate(packets) if gap > 2 * linger]
    dut = PacketBytes(linger=linger)

    async def give(ctx):
        for content, gap in packets:
            words = np.frombuffer(content, "<u8")
            for number, word in enumerate(words):
                ctx.set(dut.words.payload, {"data": int(word), "last": number == len(words) - 1})
                ctx.set(dut.words.valid, 1)
                await ctx.tick("usb").until(dut.words.ready)
                ctx.set(dut.words.valid, 0)
            for _ in range(gap):
                await ctx.tick("usb")

    async def take(ctx):
        total = sum(len(content) for content, _ in packets)
        received, ends, held = bytearray(), [], None
        while len(received) < total:
            ready = int(rng.random() >= pause)
            ctx.set(dut.o.ready, ready)
            _, _, valid, byte = await ctx.tick("usb").sample(dut.o.valid, dut.o.payload)
            assert held is None or (valid and (byte.data, byte.last) == held), "changed while held"
            held = (byte.data, byte.last) if valid and not ready else None
            if valid and ready:
                received.append(byte.data)
                if byte.last:
                    ends.append(len(received))
        assert bytes(received) == b"".join(content for content, _ in packets)
        sizes = np.cumsum([len(content) for content, _ in packets])
        assert ends == [sizes[index] for index in expected_ends]

    run(dut, give, take, domains={"usb": 1 / 60e6})


def test_a_message_ends_with_its_bulk_packet_also_with_a_full_one():
    rng = np.random.default_rng(2)
    # LUNA marks the last byte of a short packet, not that of a full one
    messages = [rng.bytes(size) for size in (12, 268, PACKET_BYTES, 20, 1)]
    dut = ControlBytes()

    async def give(ctx):
        for message in messages:
            for number, byte in enumerate(message):
                last = number == len(message) - 1 and len(message) < PACKET_BYTES
                ctx.set(dut.received.payload, {"data": byte, "last": last})
                ctx.set(dut.received.valid, 1)
                await ctx.tick("usb").until(dut.received.ready)
                ctx.set(dut.received.valid, 0)

    async def take(ctx):
        got, current = [], bytearray()
        async for _, _, valid, byte in ctx.tick().sample(dut.requests.valid, dut.requests.payload):
            if valid and byte.end:
                assert not byte.bad
                got.append(bytes(current))
                current.clear()
            elif valid:
                current.append(byte.data)
            if len(got) == len(messages):
                break
        assert got == messages

    run(dut, give, take, domains={"sync": 1e-8, "usb": 1 / 60e6})


class Ft601Model:
    """The chip's side of the write cycle, as its datasheet has it: a queue that fills and drains.

    A word is taken at a rising edge at which TXE_N and WR_N are low; TXE_N rises when the queue is
    full and falls when the host has taken some of it.
    """

    def __init__(self, rng, *, depth, drain):
        self.rng, self.depth, self.drain = rng, depth, drain
        self.level, self.full = 0, False
        self.words, self.bursts = [], []
        self.in_burst = False

    def clock(self, wr_n, be, data):
        """Take what stands at the pins at an edge; return TXE_N for the next clock."""
        if not wr_n and not self.full:
            assert be == 0xF
            self.words.append(data)
            self.level += 1
            if self.in_burst:
                self.bursts[-1] += 1
            else:
                self.bursts.append(1)
        self.in_burst = not wr_n
        if self.rng.random() < self.drain:
            self.level = max(0, self.level - int(self.rng.integers(1, self.depth + 1)))
        self.full = self.level >= self.depth
        return int(self.full)


@pytest.mark.parametrize(("depth", "drain"), [(1, 0.5), (7, 0.2), (1000, 0.01)])
def test_ft601_takes_every_word_once_in_order(depth, drain):
    rng = np.random.default_rng(depth)
    words = [int(word) for word in rng.integers(0, 1 << 63, 300)]
    chip = Ft601Model(rng, depth=depth, drain=drain)
    dut = Ft601Bursts(depth=64, burst=16, linger=40)
    waiting = []

    async def give(ctx):
        for word in words:
            if rng.random() < 0.02:
                for _ in range(int(rng.integers(1, 120))):
                    await ctx.tick("ft")
            while len(waiting) >= 64:
                await ctx.tick("ft")
            waiting.append(word)
            if rng.random() < 0.3:
                await ctx.tick("ft")

    async def queue(ctx):
        while True:
            ctx.set(dut.words.valid, bool(waiting))
            ctx.set(dut.level, len(waiting))
            ctx.set(dut.words.payload.data, waiting[0] if waiting else 0)
            _, _, ready = await ctx.tick("ft").sample(dut.words.ready)
            if ready and ctx.get(dut.words.valid):
                waiting.pop(0)

    async def pins(ctx):
        ctx.set(dut.txe_n, 0)
        for _ in range(40_000):
            _, _, wr_n, be, data = await ctx.tick("ft").sample(dut.wr_n, dut.be, dut.data)
            ctx.set(dut.txe_n, chip.clock(wr_n, be, data))
            if len(chip.words) == 2 * len(words):
                break
        halves = np.array(chip.words, "<u4").view("<u8")
        assert halves.tolist() == words

    run(dut, give, queue, pins, domains={"ft": 1e-8})


def test_ft601_gathers_bursts_and_lets_nothing_lie():
    """Words that trickle in go out in bursts; what is too little for one goes out after a while."""
    dut = Ft601Bursts(depth=64, burst=16, linger=100)
    chip = Ft601Model(np.random.default_rng(0), depth=10_000, drain=0.0)
    waiting = []

    async def queue(ctx):
        for clock in range(4000):
            if clock % 5 == 0 and clock < 5 * 37:
                waiting.append(clock)
            ctx.set(dut.words.valid, bool(waiting))
            ctx.set(dut.level, len(waiting))
            _, _, ready = await ctx.tick("ft").sample(dut.words.ready)
            if ready and waiting:
                waiting.pop(0)

    async def pins(ctx):
        ctx.set(dut.txe_n, 0)
        for _ in range(1500):
            _, _, wr_n, be, data = await ctx.tick("ft").sample(dut.wr_n, dut.be, dut.data)
            ctx.set(dut.txe_n, chip.clock(wr_n, be, data))
        assert sum(chip.bursts) == 2 * 37
        assert len(chip.bursts) <= 3
        assert chip.bursts[0] >= 2 * 16

    run(dut, queue, pins, domains={"ft": 1e-8})


def test_words_pass_the_ft601_s_link_and_its_two_clocks():
    rng = np.random.default_rng(601)
    words = [int(word) for word in rng.integers(0, 1 << 63, 200)]
    chip = Ft601Model(rng, depth=20, drain=0.1)
    dut = Ft601Link()

    async def give(ctx):
        for number, word in enumerate(words):
            ctx.set(dut.packets.payload.data, word)
            ctx.set(dut.packets.payload.last, number == len(words) - 1)
            ctx.set(dut.packets.valid, 1)
            await ctx.tick().until(dut.packets.ready)
        ctx.set(dut.packets.valid, 0)

    async def pins(ctx):
        ctx.set(dut.txe_n, 0)
        for _ in range(LINGER_CLOCKS // 2):  # words go because they are many, not for their age
            _, _, wr_n, be, data = await ctx.tick("ft").sample(dut.wr_n, dut.be, dut.data)
            ctx.set(dut.txe_n, chip.clock(wr_n, be, data))
            if len(chip.words) == 2 * len(words):
                break
        assert np.array(chip.words, "<u4").view("<u8").tolist() == words

    run(dut, give, pins, domains={"sync": 1e-8, "ft": 0.97e-8})


PAUSES = 30
"""Pauses of the camera's clock, at phases drawn by a seeded generator."""


class PausedClock(Elaboratable):
    """A design whose domain `sync` runs by hand, so that it can stand still."""

    def __init__(self, dut):
        self.dut = dut
        self.domain = ClockDomain("sync", reset_less=True)

    def elaborate(self, platform):
        m = Module()
        m.domains += self.domain
        m.submodules.dut = self.dut
        return m

    async def run(self, ctx):
        rng = np.random.default_rng(8)
        for _ in range(PAUSES):
            for _ in range(int(rng.integers(5, 60))):
                for level in (1, 0):
                    ctx.set(self.domain.clk, level)
                    await ctx.delay(5e-9)
            await ctx.delay(float(rng.integers(1, 3000)) * 1e-9)


async def accepted(ctx, domain, ready):
    """Wait for the clock in which a stream takes what is offered."""
    while not (await ctx.tick(domain).sample(ready))[2]:
        pass


def test_words_of_packets_survive_pauses_of_the_camera_s_clock():
    """The pointers of the queue stand still with their clock; the link goes on."""
    dut = PacketCrossing(domain="usb", depth=16)
    clock = PausedClock(dut)
    given, taken = [], []

    async def give(ctx):
        rng = np.random.default_rng(2)
        while True:
            word = int(rng.integers(1 << 63))
            ctx.set(dut.packets.payload, {"data": word, "last": word & 1})
            ctx.set(dut.packets.valid, 1)
            await accepted(ctx, "sync", dut.packets.ready)
            given.append(word)
            ctx.set(dut.packets.valid, 0)

    async def take(ctx):
        rng = np.random.default_rng(3)
        while True:
            ready = int(rng.random() < 0.5)
            ctx.set(dut.words.ready, ready)
            _, _, valid, word = await ctx.tick("usb").sample(dut.words.valid, dut.words.payload)
            if ready and valid:
                assert word.last == word.data & 1
                taken.append(word.data)

    run(clock, give, take, clock.run, domains={"usb": 1 / 60e6})
    assert len(taken) > 10 * PAUSES
    assert taken == given[: len(taken)]
    assert len(given) - len(taken) <= dut.depth + 2


def test_requests_survive_pauses_of_the_camera_s_clock():
    """USB gives bytes while the camera stands still: they wait, none is lost or doubled."""
    dut = ControlBytes()
    clock = PausedClock(dut)
    given, taken = [], []

    async def give(ctx):
        rng = np.random.default_rng(2)
        while True:
            byte, last = int(rng.integers(256)), int(rng.random() < 0.1)
            ctx.set(dut.received.payload, {"data": byte, "last": last})
            ctx.set(dut.received.valid, 1)
            await accepted(ctx, "usb", dut.received.ready)
            ctx.set(dut.received.valid, 0)
            given.append(byte)
            if last:
                given.append("end")

    async def take(ctx):
        while True:
            _, _, valid, byte = await ctx.tick("sync").sample(
                dut.requests.valid, dut.requests.payload
            )
            if valid:
                taken.append("end" if byte.end else byte.data)

    run(clock, give, take, clock.run, domains={"usb": 1 / 60e6})
    assert len(taken) > 10 * PAUSES
    assert taken == given[: len(taken)]
    assert len(given) - len(taken) <= 16 + 4
