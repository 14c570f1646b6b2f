# SPDX-License-Identifier: Apache-2.0
"""CRC-32C of a packet at eight bytes a clock, cut into three stages.

The register after eight bytes is A64·(register + first four) + A32·(last four), where Ak
moves the register on by k zero bits and + is exclusive or. Only A64·register is a loop; all
the rest is computed on the way there.

# Ref: the polynomial is CRC-32/ISCSI's (RFC 3720 appendix B.4), bits reflected. The split:
# Kounavis & Berry, "Novel table lookup-based algorithms for high-performance CRC
# generation", IEEE Transactions on Computers 57(11), 2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import xor

from amaranth.hdl import Const, Module, Mux, Signal, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

POLYNOMIAL = 0x82F6_3B78
"""x^32 + x^28 + x^27 + … + 1 with its bits reflected."""
ONES = 0xFFFF_FFFF
WIDTH = 32
PART = 16


def advance(register: int, bits: int, /) -> int:
    """Return the register after `bits` zero bits; as many back if `bits` is negative."""
    for _ in range(bits):
        register = register >> 1 ^ (POLYNOMIAL if register & 1 else 0)
    for _ in range(-bits):
        out = register >> WIDTH - 1
        register = (register ^ (POLYNOMIAL if out else 0)) << 1 | out
    return register


def _moved(value: Value, first: int, bits: int) -> Value:
    """Return the register when `value` goes into it from bit `first` on and `bits` zeros follow."""
    # a multiplexer for each bit: compiled simulation is far slower with a sum for each row
    columns = (Const(advance(1 << first + i, bits), WIDTH) for i in range(len(value)))
    return reduce(xor, (Mux(value[i], column, 0) for i, column in enumerate(columns)))


class PacketCrc(wiring.Component):
    """CRC-32C of a packet whose last four bytes are the CRC itself.

    The CRC is over all but the last half word, so words are regrouped: the last half of one
    and the first half of the next. Before the first half of a packet stand four bytes of 0
    and a register that they turn into the standard's starting value.

    Members
    -------
    valid : In(1)
        There is a word.
    word : In(64)
        Eight bytes; in a packet's last word, only the first four count.
    last : In(1)
        It is the packet's last.
    value : Out(32)
        The packet's CRC, two clocks after its last word, for one clock.
    """

    latency = 2

    def __init__(self) -> None:
        super().__init__(
            {
                "valid": In(1),
                "word": In(64),
                "last": In(1),
                "value": Out(WIDTH),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        before = Signal(WIDTH)
        with m.If(self.valid):
            with m.If(self.last):
                m.d.sync += before.eq(0)
            with m.Else():
                m.d.sync += before.eq(self.word[WIDTH:])

        # 1: what each half word and half does to the register
        parts: list[Signal] = []
        for half, bits in ((before, 2 * WIDTH), (self.word[:WIDTH], WIDTH)):
            for first in range(0, WIDTH, PART):
                part = Signal(WIDTH, name=f"part{len(parts)}", reset_less=True)
                m.d.sync += part.eq(_moved(half[first : first + PART], first, bits))
                parts.append(part)
        valid1, last1 = Signal(), Signal()
        m.d.sync += [valid1.eq(self.valid), last1.eq(self.last)]

        # 2: together
        change = Signal(WIDTH, reset_less=True)
        valid2, last2 = Signal(), Signal()
        m.d.sync += [
            change.eq(reduce(xor, parts)),
            valid2.eq(valid1),
            last2.eq(last1),
        ]

        # 3: the loop
        start = advance(ONES, -WIDTH)
        register = Signal(WIDTH, init=start)
        after = Signal(WIDTH)
        m.d.comb += [
            after.eq(_moved(register, 0, 2 * WIDTH) ^ change),
            self.value.eq(~after),
        ]
        with m.If(valid2):
            m.d.sync += register.eq(after)
            with m.If(last2):
                m.d.sync += register.eq(start)
        return m


def crc_of_words(words: Sequence[int], /) -> int:
    """Return what `PacketCrc` gives for whole words and the low half of the last one."""
    register = advance(ONES, -WIDTH)
    before = 0
    for word in words:
        register = advance(register ^ before, 2 * WIDTH) ^ advance(word & ONES, WIDTH)
        before = word >> WIDTH
    return register ^ ONES
