# SPDX-License-Identifier: Apache-2.0
"""What lies between the camera and the vendor's pipes; the vendor's own modules are not public."""

import numpy as np
from amaranth.sim import Simulator

from hueflight_hdl.link.opal_kelly import BLOCK_BYTES, OpalKellyStreams
from hueflight_protocol.cobs import CobsDecoder, cobs_encode


def run(dut, *processes):
    simulator = Simulator(dut)
    simulator.add_clock(1e-8, domain="sync")
    simulator.add_clock(9.92e-9, domain="ok")
    *others, last = processes
    for process in others:
        simulator.add_testbench(process, background=True)
    simulator.add_testbench(last)
    simulator.run()


def test_requests_come_as_cobs_in_words():
    rng = np.random.default_rng(4)
    messages = [rng.bytes(size) for size in (12, 13, 14, 15, 268)]
    dut = OpalKellyStreams()

    async def write(ctx):
        for message in messages:
            frame = cobs_encode(message) + b"\0"
            frame += bytes(-len(frame) % 4)
            for word in np.frombuffer(frame, "<u4"):
                ctx.set(dut.request_data, int(word))
                ctx.set(dut.request_write, 1)
                await ctx.tick("ok")
            ctx.set(dut.request_write, 0)
            for _ in range(300):  # a host waits for the answer
                await ctx.tick("ok")

    async def take(ctx):
        got, current = [], bytearray()
        async for _, _, valid, byte in ctx.tick().sample(dut.requests.valid, dut.requests.payload):
            if valid and byte.end:
                if current:
                    assert not byte.bad
                    got.append(bytes(current))
                current.clear()
            elif valid:
                current.append(byte.data)
            if len(got) == len(messages):
                break
        assert got == messages

    run(dut, write, take)


def test_responses_fill_whole_words():
    rng = np.random.default_rng(5)
    messages = [rng.bytes(size) for size in (12, 13, 14, 15, 44)]
    dut = OpalKellyStreams()

    async def give(ctx):
        for message in messages:
            for number, byte in enumerate(message):
                last = number == len(message) - 1
                ctx.set(dut.responses.payload, {"data": byte, "last": last})
                ctx.set(dut.responses.valid, 1)
                await ctx.tick().until(dut.responses.ready)
            ctx.set(dut.responses.valid, 0)

    async def read(ctx):
        decoder, got = CobsDecoder(limit=300), []
        while len(got) < len(messages):
            await ctx.tick("ok")
            if ctx.get(dut.responses_wait):
                ctx.set(dut.response_read, 1)
                await ctx.tick("ok")
                ctx.set(dut.response_read, 0)
                word = ctx.get(dut.response_data).to_bytes(4, "little")
                got += [bytes(message) for message in decoder.feed(word) if message]
        assert got == messages

    run(dut, give, read)


def test_packets_are_read_in_whole_blocks():
    words = np.random.default_rng(6).integers(0, 1 << 63, 2 * BLOCK_BYTES // 8, np.uint64)
    dut = OpalKellyStreams()

    async def give(ctx):
        for number, word in enumerate(words):
            ctx.set(dut.packets.payload, {"data": int(word), "last": number % 7 == 6})
            ctx.set(dut.packets.valid, 1)
            await ctx.tick().until(dut.packets.ready)
        ctx.set(dut.packets.valid, 0)

    async def read(ctx):
        halves = []
        for _ in range(2):
            clocks = 0
            while not ctx.get(dut.block_ready):
                assert not halves or clocks < 1000
                await ctx.tick("ok")
                clocks += 1
            for _ in range(BLOCK_BYTES // 4):
                ctx.set(dut.packet_read, 1)
                await ctx.tick("ok")
                halves.append(ctx.get(dut.packet_data))
            ctx.set(dut.packet_read, 0)
            for _ in range(8):
                await ctx.tick("ok")
        assert np.array(halves, "<u4").tobytes() == words.astype("<u8").tobytes()
        assert not ctx.get(dut.block_ready)

    run(dut, give, read)
