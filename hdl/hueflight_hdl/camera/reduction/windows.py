# SPDX-License-Identifier: Apache-2.0
"""Windows of frames behind the sums: each block of pixels ends its own, one block after another.

Pixels are divided into *blocks*, those of one packet. A picture is over in one block after the
other, so that a buffer for one block is all that is needed beside the sums: when its window is
over, the next frame finds the block's sums, has them stored and begins anew from 0. Where no frame
comes, the sums are read without one.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from hueflight_protocol.wire import FrameFlags

FRAME_BITS = 32
"""Width of the number of frames of a window."""
MORE_BITS = 16
"""Bits that the number of frames of a capture has more, so that it reaches for centuries."""
FLAG_BITS = int(sum(FrameFlags)).bit_length()
SETTLE = 5
"""Clocks from the last beat of a block to its sums in the buffer and all that is said of them."""


class BlockPlan:
    """How the groups of a frame are divided into blocks.

    Parameters
    ----------
    groups, block_groups : int
        Groups of a frame, and of all blocks but the last.
    frame_bits : int
        Width of the number of frames of a window.

    Attributes
    ----------
    blocks, last_groups : int
        Number of blocks, and groups of the last one.
    total_bits : int
        Width of the number of frames of a capture.
    """

    def __init__(self, groups: int, block_groups: int, frame_bits: int = FRAME_BITS) -> None:
        self.frame_bits = frame_bits
        self.groups, self.block_groups = groups, min(block_groups, groups)
        self.blocks = -(-groups // self.block_groups)
        self.last_groups = groups - (self.blocks - 1) * self.block_groups
        self.total_bits = frame_bits + MORE_BITS

    def groups_of(self, block: Value, /) -> Value:
        """Return the groups of a block.

        Parameters
        ----------
        block : Value
            Its number.

        Returns
        -------
        Value
            Their number.
        """
        return Mux(block == self.blocks - 1, self.last_groups, self.block_groups)

    def place_layout(self) -> data.StructLayout:
        """Return the layout of a place: group, its block, place in it, if it is the block's last.

        Returns
        -------
        StructLayout
            The layout.
        """
        return data.StructLayout(
            {
                "group": range(self.groups),
                "block": range(self.blocks),
                "at": range(self.block_groups),
                "last": 1,
            }
        )


def window_layout(plan: BlockPlan, lanes: int, /) -> data.StructLayout:
    """Return the layout of what is said of the frames of a window.

    Parameters
    ----------
    plan : BlockPlan
        Blocks of a frame.
    lanes : int
        Pixels of a group.

    Returns
    -------
    StructLayout
        Frames, codes that were added, and flags of all frames together.
    """
    pixels = plan.block_groups * lanes
    return data.StructLayout(
        {
            "frames": plan.frame_bits,
            "photons": plan.frame_bits + pixels.bit_length(),
            "flags": FLAG_BITS,
        }
    )


def block_layout(plan: BlockPlan, lanes: int, /) -> data.StructLayout:
    """Return the layout of what is said of a block that can be fetched.

    Parameters
    ----------
    plan : BlockPlan
        Blocks of a frame.
    lanes : int
        Pixels of a group.

    Returns
    -------
    StructLayout
        Picture that the block belongs to, place, frames behind it, frames that came since the
        window before and are not in it, periods per exposure of the last frame.
    """
    return data.StructLayout(
        {
            "picture": 32,
            "first_group": range(plan.groups),
            "groups": range(plan.block_groups + 1),
            "window": window_layout(plan, lanes),
            "missed": 32,
            "periods": 32,
        }
    )


class BlockWindows(wiring.Component):
    """Decides when the window of each block is over, and counts what is in it.

    Windows end one block after another, spread over `frames_per_picture` frames. As long as what
    has been stored is fetched in time, each window has as many frames, but for the first ones,
    which begin together and are shorter. Otherwise all that follow wait, and are longer.

    A frame that ends early is in the sums of some pixels and can't be taken out: the windows that
    it belongs to begin anew. A window that was over before that frame is kept.

    Parameters
    ----------
    plan : BlockPlan
        Blocks of a frame.
    lanes : int
        Pixels of a group.
    late : int
        Clocks by which sums are stored later than `store` says.

    Members
    -------
    place : In
        Where the next clock's beat or look is, see `BlockPlan.place_layout`.
    valid, look : In(1)
        A beat, or a look at sums while no frame comes, in this clock.
    frame_last : In(1)
        The beat is the last of its frame.
    discard : In(1)
        The frame before this clock ended early. No beat.
    count, flags, periods : In
        Codes that the beat adds; what is said of its frame.
    lost : In(1)
        A frame came that is not added.
    frames_per_picture : In
        Frames of a window; 0 as 1.
    clear : In(1)
        Begin anew, with all windows empty and pictures counted from 0. No beat comes.
    finish : In(1)
        End all windows, until `drained`. No beat comes.
    drained : Out(1)
        Nothing is left to be fetched.
    fresh : Out(1)
        The sums of the beat begin from 0.
    store, store_fresh : Out(1)
        The sums before the beat, or those that are looked at, belong to the buffer; as 0.
    wanted : Out(1), wanted_place, taken : Out
        A block whose sums are to be stored, its first place, and how many of its groups have been.
    ready : Out(1), done : In(1)
        A block can be fetched from the buffer; it was.
    block : Out
        What is said of it, see `block_layout`; held while `ready`.
    full : Out(1)
        A window has as many frames as can be counted: another one must not come.
    """

    def __init__(self, plan: BlockPlan, lanes: int, *, late: int = 0) -> None:
        self.plan, self.lanes, self.late = plan, lanes, late
        self.window_layout = window_layout(plan, lanes)
        super().__init__(
            {
                "place": In(plan.place_layout()),
                "valid": In(1),
                "look": In(1),
                "frame_last": In(1),
                "discard": In(1),
                "count": In(range(lanes + 1)),
                "flags": In(FLAG_BITS),
                "periods": In(32),
                "lost": In(1),
                "frames_per_picture": In(plan.frame_bits),
                "clear": In(1),
                "finish": In(1),
                "drained": Out(1),
                "fresh": Out(1),
                "store": Out(1),
                "store_fresh": Out(1),
                "wanted": Out(1),
                "wanted_place": Out(plan.place_layout()),
                "taken": Out(range(plan.block_groups + 1)),
                "ready": Out(1),
                "done": In(1),
                "block": Out(block_layout(plan, lanes)),
                "full": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        plan, taken, total_bits = self.plan, self.taken, self.plan.total_bits
        here = Signal(plan.place_layout())  # of the beat or look in this clock
        m.d.sync += here.eq(self.place)
        record, since, write = self._ledger(m, here)

        void = Signal(init=1)  # no block has a whole frame in its window
        empty, first_take, taking, over = Signal(), Signal(), Signal(), Signal()
        mine, ends = Signal(), Signal()
        first_round = Signal(init=1)
        stored_fresh, total = Signal(), Signal(total_bits)
        m.d.comb += [
            mine.eq(self.wanted & (here.block == self.wanted_place.block)),
            taking.eq(self.valid & mine & (here.at == taken)),
            self.store.eq(taking | (self.look & mine)),
            over.eq(self.store & here.last),
            first_take.eq((taken == 0) & Mux(self.valid, taking, over)),
            empty.eq(void | record.fresh),
            self.store_fresh.eq(Mux(taken == 0, empty, stored_fresh)),
            self.fresh.eq(taking | empty),
            ends.eq(self.valid & self.frame_last),
        ]
        m.d.sync += total.eq(total + (ends | self.discard) + self.lost)
        with m.If(taking):
            m.d.sync += taken.eq(taken + 1)
        with m.If(first_take):
            m.d.sync += stored_fresh.eq(empty)
        with m.If(ends):
            m.d.sync += void.eq(0)
        with m.If(self.discard):
            m.d.sync += void.eq(1)

        window = Signal(self.window_layout)
        m.d.comb += window.eq(Mux(empty, 0, record.window))
        m.d.comb += write.data.fresh.eq(first_take | empty)
        self._count(m, here, Mux(first_take, 0, window), over, write)
        m.d.comb += [
            write.en.eq(self.valid | (self.look & first_take)),
            write.data.since.eq(Mux(first_take, total, since)),
        ]
        self._tell(m, first_take, window, Mux(first_round, 0, since), total)
        self._schedule(m, over, ends, total, first_take)

        with m.If(over):
            m.d.sync += taken.eq(0)
            with m.If(here.block == plan.blocks - 1):
                m.d.sync += first_round.eq(0)
        with m.If(self.clear):
            m.d.sync += [void.eq(1), first_round.eq(1), total.eq(0), taken.eq(0)]
        return m

    def _ledger(self, m: Module, here: Signal) -> tuple[data.View, Value, data.View]:
        """Return what is said of a block, when its window began, and the port that writes it."""
        layout = data.StructLayout(
            {"fresh": 1, "window": self.window_layout, "since": self.plan.total_bits}
        )
        m.submodules.ledger = memory = Memory(
            shape=layout, depth=self.plan.blocks, init=[], attrs={"ram_style": "distributed"}
        )
        write = memory.write_port()
        read = memory.read_port(transparent_for=(write,))
        m.d.comb += [read.addr.eq(self.place.block), write.addr.eq(here.block)]
        return read.data, read.data.since, write

    def _count(
        self, m: Module, here: Signal, before: Value, over: Signal, write: data.View
    ) -> None:
        """Count the frame in the window of its block when it leaves the block."""
        so_far, count = Signal(range(self.plan.block_groups * self.lanes + 1)), Signal()
        total = Signal.like(so_far)
        window = self.window_layout(before)
        after = write.data.window
        m.d.comb += [
            total.eq(Mux(here.at == 0, 0, so_far) + self.count),
            count.eq(self.valid & here.last),
            after.frames.eq(window.frames + count),
            after.photons.eq(window.photons + Mux(count, total, 0)),
            after.flags.eq(window.flags | Mux(count, self.flags, 0)),
        ]
        with m.If(self.valid):
            m.d.sync += so_far.eq(total)
        with m.If(over | self.clear | self.discard):
            # a frame or two find the next window still too long, but far from the greatest number
            m.d.sync += self.full.eq(0)
        with m.If(count):
            m.d.comb += write.data.fresh.eq(0)
            with m.If(after.frames[-1]):
                m.d.sync += self.full.eq(1)

    def _tell(
        self, m: Module, first_take: Signal, window: Signal, since: Value, total: Signal
    ) -> None:
        """Hold what is said of a window that is over."""
        came, then, between, missed = (Signal.like(total) for _ in range(4))
        periods = Signal(32)
        m.d.sync += [between.eq(came - then), missed.eq(between - self.block.window.frames)]
        m.d.comb += self.block.missed.eq(Mux(missed >> 32 == 0, missed, -1))
        with m.If(self.valid & self.frame_last):
            m.d.sync += periods.eq(self.periods)
        with m.If(first_take):
            m.d.sync += [
                self.block.window.eq(window),
                came.eq(total),
                then.eq(since),
                self.block.periods.eq(periods),
                self.block.first_group.eq(self.wanted_place.group),
            ]

    def _schedule(
        self, m: Module, over: Signal, ends: Signal, total: Signal, first_take: Signal
    ) -> None:
        """Choose the block whose window ends next, and when."""
        plan, next_place = self.plan, self.wanted_place
        most, due = (
            Signal(plan.frame_bits, init=1),
            Signal(plan.frame_bits + plan.blocks.bit_length()),
        )
        owed, held, drain = Signal(), Signal(), Signal(SETTLE + self.late)
        begun, left = Signal.like(total), Signal()  # when the window of the first block began
        number = Signal(32)
        m.d.sync += [
            most.eq(Mux(self.frames_per_picture == 0, 1, self.frames_per_picture)),
            left.eq((next_place.block != 0) | (total != begun)),
            drain.eq(drain << 1),
            owed.eq(due >= most),
        ]
        # each frame is worth as many steps as there are blocks, each block as many as frames
        m.d.comb += [
            self.drained.eq(self.finish & ~self.wanted & ~held & ~left),
        ]
        with m.If(ends & ~owed):
            m.d.sync += due.eq(due + plan.blocks)
        with m.If(~self.wanted & ~held & (owed | (self.finish & left))):
            m.d.sync += self.wanted.eq(1)
            with m.If(owed):
                m.d.sync += due.eq(due - most)
        with m.If(first_take & (next_place.block == 0)):
            m.d.sync += begun.eq(total)
        ends_here = next_place.block == plan.blocks - 1
        with m.If(over):
            m.d.sync += [
                self.wanted.eq(0),
                held.eq(1),
                drain.eq(1),
                self.block.picture.eq(number),
                self.block.groups.eq(plan.groups_of(next_place.block)),
                next_place.block.eq(Mux(ends_here, 0, next_place.block + 1)),
                next_place.group.eq(Mux(ends_here, 0, next_place.group + plan.block_groups)),
                number.eq(number + ends_here),
            ]
        with m.If(drain[-1]):
            m.d.sync += self.ready.eq(1)
        with m.If(self.done & self.ready):
            m.d.sync += [self.ready.eq(0), held.eq(0)]
        with m.If(self.clear):
            m.d.sync += [
                self.wanted.eq(0), due.eq(0), begun.eq(0), number.eq(0), next_place.eq(0),
            ]  # fmt: skip
