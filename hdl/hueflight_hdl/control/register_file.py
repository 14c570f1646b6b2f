# SPDX-License-Identifier: Apache-2.0
"""The register file, made from a register map.

Everything that the host wrote, and every constant, is read back from one memory, so that only
values set by the hardware need a multiplexer. A second, read-only memory states for each address
whether there is a register, which accesses are allowed and which bits it has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from amaranth.hdl import Array, Const, Module, Mux, Shape, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from hueflight_protocol.errors import HueflightError
from hueflight_protocol.registers import (
    ADDRESS_BITS,
    WORD_BITS,
    Access,
    Register,
    RegisterMap,
    Reserved,
)

LockOf = Callable[[Register, tuple[int, ...]], "int | None"]


class RegisterFileError(HueflightError):
    """The gateware cannot implement a register map as requested."""


class RegisterFile(wiring.Component):
    """The registers of a board.

    Every register is a member of its name; elements of an array are those of an
    `ArrayLayout`. By access:

    ========  ==================================================================
    `CONST`   no member; `constants` has the values of the build
    `RO`      In
    `RW`      Out; unless `unkept`, which have no flip-flops (see `written`)
    `W1C`     Out, what is held; and In, NAME ``_set``: sets it
    `PULSE`   Out, high for one clock
    `KEY`     Out, what was written, in the clock in which NAME ``_written`` is high
    ========  ==================================================================

    Parameters
    ----------
    registers : RegisterMap
    constants : mapping
        Values of CONST registers by name, or by name and indices; others have their reset value.
    unkept : iterable of str
        RW registers that the design stores itself, from `written`; they are read back here.
    windows : iterable of str
        One-dimensional RW registers at addresses above all others that the design stores *and*
        reads back: for the read it gives, NAME ``_word``, two clocks after `address`.
    lock_of : callable, optional
        Register and indices to the number of the lock that refuses writes to it, or None.
    locks : int
        How many there are.

    Members
    -------
    address : In(17)
        What the four below look up, three clocks later.
    exists, writable, refused : Out(1)
    word : Out(32)
        What a read gives.
    reading : In(1)
        The word is taken for a read: holds the high words of 64-bit values.
    write : In(1), write_word : In(32)
        Writes to `address`, which must have stood for three clocks.
    locked : In(locks)
    written : Out(1), written_address : Out(16), written_word : Out(32)
        Every write, one clock later.
    """

    latency = 3

    def __init__(
        self,
        registers: RegisterMap,
        /,
        *,
        constants: Mapping[str | tuple[str, tuple[int, ...]], int] | None = None,
        unkept: Iterable[str] = (),
        windows: Iterable[str] = (),
        lock_of: LockOf | None = None,
        locks: int = 0,
    ) -> None:
        self.registers = registers
        self.constants = dict(constants or {})
        self.unkept = frozenset(unkept)
        self.windows = tuple(windows)
        self.lock_of = lock_of or (lambda register, indices: None)
        self.locks = locks
        members: dict[str, wiring.Member] = {
            "address": In(ADDRESS_BITS + 1),
            "exists": Out(1),
            "writable": Out(1),
            "refused": Out(1),
            "word": Out(WORD_BITS),
            "reading": In(1),
            "write": In(1),
            "write_word": In(WORD_BITS),
            "locked": In(locks),
            "written": Out(1),
            "written_address": Out(ADDRESS_BITS),
            "written_word": Out(WORD_BITS),
        }
        for register in registers:
            members |= self._members(register)
        super().__init__(members)

    def _members(self, register: Register) -> dict[str, wiring.Member]:
        name = register.name
        if name in self.windows:
            return {f"{name}_word": In(WORD_BITS)}
        shape = register_layout(register)
        match register.access:
            case Access.CONST:
                return {}
            case Access.RO:
                return {name: In(shape)}
            case Access.RW:
                return {} if name in self.unkept else {name: Out(shape, init=_reset(register))}
            case Access.W1C:
                return {name: Out(shape), f"{name}_set": In(shape)}
            case Access.PULSE:
                return {name: Out(shape)}
            case Access.KEY:
                return {name: Out(shape), f"{name}_written": Out(1)}

    # -- layout of the address space ------------------------------------------------------------

    @property
    def depth(self) -> int:
        """Words of the memories."""
        last = max(
            register.address_of(*indices) + register.words
            for register in self.registers
            for indices in register.elements()
            if register.name not in self.windows
        )
        return 1 << (last - 1).bit_length()

    def _attributes(self, masks: list[int]) -> list[data.Const]:
        layout = self._attribute_layout(masks)
        table = [layout.const({})] * self.depth
        for register in self.registers:
            if register.name in self.windows:
                continue
            for indices in register.elements():
                lock = self.lock_of(register, indices)
                for word in range(register.words):
                    table[register.address_of(*indices) + word] = layout.const(
                        {
                            "exists": 1,
                            "writable": register.access.writable,
                            "kept": register.access in (Access.CONST, Access.RW),
                            "lock": 0 if lock is None else lock + 1,
                            "mask": masks.index(_mask(register, word)),
                        }
                    )
        return table

    def _attribute_layout(self, masks: list[int]) -> data.StructLayout:
        return data.StructLayout(
            {
                "exists": 1,
                "writable": 1,
                "kept": 1,  # read back from the memory
                "lock": range(self.locks + 1),
                "mask": range(len(masks)),
            }
        )

    def _initial(self) -> list[int]:
        table = [0] * self.depth
        for register in self.registers:
            if register.access not in (Access.CONST, Access.RW) or register.name in self.windows:
                continue
            for indices in register.elements():
                value = register.reset
                if register.access is Access.CONST:
                    value = self.constants.get(register.name, value)
                    value = self.constants.get((register.name, indices), value)
                if register.name == "map":
                    value = self.registers.fingerprint
                for word in range(register.words):
                    part = value >> WORD_BITS * word & (1 << WORD_BITS) - 1
                    table[register.address_of(*indices) + word] = part
        return table

    # -- hardware -------------------------------------------------------------------------------

    def elaborate(self, platform: object) -> Module:
        m = Module()
        masks = sorted({_mask(r, w) for r in self.registers for w in range(r.words)})
        layout = self._attribute_layout(masks)
        m.submodules.attributes = rom = Memory(
            shape=layout, depth=self.depth, init=self._attributes(masks)
        )
        m.submodules.store = store = Memory(shape=WORD_BITS, depth=self.depth, init=self._initial())
        attribute_port = rom.read_port(domain="sync")
        load = store.read_port(domain="sync")
        save = store.write_port(domain="sync")
        low = range(self.depth.bit_length() - 1)
        inside_before = Signal()
        inside = Signal()
        m.d.sync += [
            inside_before.eq(self.address[len(low) :] == 0),
            inside.eq(inside_before),
        ]
        m.d.comb += [
            attribute_port.en.eq(1),
            attribute_port.addr.eq(self.address),
            load.en.eq(1),
            load.addr.eq(self.address),
        ]

        # 2: out of the memories, whose outputs are slow; 3: attributes and word
        attributes = Signal(layout)
        kept = Signal(WORD_BITS)
        m.d.sync += [attributes.eq(attribute_port.data), kept.eq(load.data)]
        lock = Signal(self.locks + 1)
        mask = Signal(WORD_BITS)
        live = self._live_word(m)
        m.d.comb += lock.eq(self.locked << 1)
        m.d.sync += [
            self.exists.eq(inside & attributes.exists),
            self.writable.eq(inside & attributes.writable),
            self.refused.eq(inside & (lock >> attributes.lock)[0]),
            mask.eq(Array(Const(value, WORD_BITS) for value in masks)[attributes.mask]),
            self.word.eq(Mux(attributes.kept, kept, live)),
        ]
        self._windows(m, mask)

        # writes: masked, kept for reading back, and announced
        # (what does not exist or can't be written never comes here)
        keep = Signal()
        m.d.sync += keep.eq(inside & attributes.kept)
        m.d.sync += [
            self.written.eq(self.write),
            self.written_address.eq(self.address),
            self.written_word.eq(self.write_word & mask),
            save.en.eq(self.write & keep),
            save.addr.eq(self.address),
            save.data.eq(self.write_word & mask),
        ]
        for register in self.registers:
            if register.name not in self.unkept and register.name not in self.windows:
                self._hardware_side(m, register)
        return m

    def _live_word(self, m: Module) -> Signal:
        """Return what the hardware says at the address, two clocks later."""
        live = Signal(WORD_BITS)
        words: dict[int, Value] = {}
        for register in self.registers:
            if register.access not in (Access.RO, Access.W1C):
                continue
            source = Value.cast(getattr(self, register.name))
            width = len(source) // len(list(register.elements()))
            for number, indices in enumerate(register.elements()):
                element = source[number * width : (number + 1) * width]
                address = register.address_of(*indices)
                words[address] = element[:WORD_BITS]
                if register.words == 2:
                    words[address + 1] = self._held(m, address, element[WORD_BITS:])
        # one bit for each address, then one wide or: shallower than a multiplexer
        hits = Signal(len(words))
        low = (self.depth - 1).bit_length()
        m.d.sync += [
            *(hits[i].eq(self.address[:low] == address) for i, address in enumerate(words)),
            live.eq(_any_of(Mux(hits[i], word, 0) for i, word in enumerate(words.values()))),
        ]
        return live

    def _held(self, m: Module, address: int, high: Value) -> Signal:
        """Return the high word as it was when the low one was last read."""
        held = Signal(WORD_BITS)
        # as old as the low word that goes with it
        before = [Signal(WORD_BITS, name=f"before{i}") for i in range(2)]
        m.d.sync += [before[0].eq(high), before[1].eq(before[0])]
        with m.If(self.reading & (self.address == address)):
            m.d.sync += held.eq(before[-1])
        return held

    def _windows(self, m: Module, mask: Signal) -> None:
        """Look up registers that the design keeps in memories of its own."""
        for name in self.windows:
            register = self.registers[name]
            first, count = register.address, register.count[0]
            if register.strides != (1,) or first < self.depth:
                raise RegisterFileError(
                    f"window {name!r} at {first:#06x}: must have stride 1 and begin at or above "
                    f"{self.depth:#06x}"
                )
            hit_before = Signal(name=f"{name}_hit_before")
            hit = Signal(name=f"{name}_hit")
            m.d.sync += [
                hit_before.eq((self.address >= first) & (self.address < first + count)),
                hit.eq(hit_before),
            ]
            with m.If(hit):
                m.d.sync += [
                    self.exists.eq(1),
                    self.writable.eq(1),
                    mask.eq(_mask(register, 0)),
                    self.word.eq(getattr(self, f"{name}_word")),
                ]

    def _hardware_side(self, m: Module, register: Register) -> None:
        access, name = register.access, register.name
        if not access.writable:
            return
        target = Value.cast(getattr(self, name))
        width = len(target) // len(list(register.elements()))
        if access is Access.PULSE:
            m.d.sync += target.eq(0)
        for number, indices in enumerate(register.elements()):
            element = target[number * width : (number + 1) * width]
            address = register.address_of(*indices)
            here = Signal(name=f"{name}_{number}_here")
            m.d.comb += here.eq(self.written & (self.written_address == address))
            if access is Access.W1C:
                cleared = Mux(here, self.written_word, 0)
                setting = Value.cast(getattr(self, f"{name}_set"))
                m.d.sync += element.eq((element & ~cleared) | setting)
            else:
                with m.If(here):
                    m.d.sync += element.eq(self.written_word)
            if access is Access.KEY:
                m.d.sync += getattr(self, f"{name}_written").eq(here)


def register_layout(register: Register) -> data.Layout:
    """Return the layout of a register's fields, within an array of its elements."""
    fields: dict[str, data.Field] = {}
    shift = 0
    for part in register.parts:
        if not isinstance(part, Reserved):
            shape = Shape(part.width, part.signed)
            fields[part.name] = data.Field(shape, shift)
        shift += part.width
    layout: data.Layout = data.FlexibleLayout(shift, fields)
    for count in reversed(register.count):
        layout = data.ArrayLayout(layout, count)
    return layout


def _reset(register: Register) -> object:
    fields = {name: place.field.reset for name, place in register.fields.items()}
    value: object = fields
    for count in reversed(register.count):
        value = [value] * count
    return value


def _mask(register: Register, word: int) -> int:
    return register.mask >> WORD_BITS * word & (1 << WORD_BITS) - 1


def _any_of(words: Iterable[Value]) -> Value:
    """Return the or of all words, as a balanced tree."""
    level = list(words)
    while len(level) > 1:
        pairs = [a | b for a, b in zip(level[::2], level[1::2], strict=False)]
        level = pairs + level[len(level) & ~1 :]
    return level[0] if level else Const(0, WORD_BITS)
