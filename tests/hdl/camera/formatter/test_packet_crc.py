# SPDX-License-Identifier: Apache-2.0
"""The CRC in gateware against the published check value and a library."""

import google_crc32c
import numpy as np
from amaranth.sim import Simulator
from hypothesis import given
from hypothesis import strategies as st

from hueflight_hdl.camera.formatter.packet_crc import ONES, PacketCrc, advance, crc_of_words
from hueflight_protocol.checksum import CRC_CHECK_INPUT, CRC_CHECK_VALUE


def test_polynomial_is_crc32c():
    register = ONES
    for byte in CRC_CHECK_INPUT:
        register = advance(register ^ byte, 8)
    assert register ^ ONES == CRC_CHECK_VALUE


@given(st.integers(0, ONES), st.integers(0, 200))
def test_advance_has_an_inverse(register, bits):
    assert advance(advance(register, bits), -bits) == register


@given(st.lists(st.integers(0, (1 << 64) - 1), min_size=1, max_size=20))
def test_regrouped_words_give_the_same(words):
    data = np.array(words, "<u8").tobytes()[:-4]
    assert crc_of_words(words) == google_crc32c.value(data)


def test_gateware_over_packets_with_pauses():
    rng = np.random.default_rng(5)
    packets = [rng.integers(0, 1 << 64, size, np.uint64) for size in (1, 2, 3, 10, 40, 1, 1)]
    dut = PacketCrc()
    values = []

    async def drive(ctx):
        for packet in packets:
            for number, word in enumerate(packet):
                while rng.random() < 0.3:
                    await ctx.tick()
                ctx.set(dut.word, int(word))
                ctx.set(dut.last, number == len(packet) - 1)
                ctx.set(dut.valid, 1)
                await ctx.tick()
                ctx.set(dut.valid, 0)
        await ctx.tick().repeat(4)

    async def watch(ctx):
        ended = [False] * dut.latency
        async for _, _, valid, last, value in ctx.tick().sample(dut.valid, dut.last, dut.value):
            if ended[0]:
                values.append(value)
            ended = [*ended[1:], bool(valid and last)]

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_process(watch)
    simulator.add_testbench(drive)
    simulator.run()
    assert values == [google_crc32c.value(packet.tobytes()[:-4]) for packet in packets]
