# SPDX-License-Identifier: Apache-2.0
"""A synthetic sensor: a counter, random codes, or a small scene."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In
from amaranth.utils import ceil_log2

from hueflight_protocol.camera_map import SyntheticSource

from ..frame_format import FrameFormat
from .port import SensorPort
from .scene import BLOCK, DEPTH_BITS, JITTER_BITS, MATERIALS, OUTCOMES, Scene

SYNTHETIC_LAYOUT = data.StructLayout(
    {
        "source": SyntheticSource,
        "occupancy": 16,  # of random codes, in 1/65536
        "seed": 32,
        "delay_start": 16,  # of the scene, in codes
        "delay_step": 16,  # from frame to frame
    }
)
"""Settings; seed and first delay are taken over when a capture begins."""

SEEDS = tuple((0x9E37_79B9 * lane) & 0xFFFF_FFFF for lane in range(8))
"""What tells the lanes' generators apart: multiples of 2^32 over the golden ratio."""

LATENCY = 7


class SyntheticSensor(wiring.Component):
    """Answers a read with a frame, a beat in every clock.

    *Counter*: pixel p of frame f has code p + f, modulo the number of codes. *Random*: each
    lane has a 32-bit xorshift generator, which steps with every beat; the upper half of its
    state, if below `occupancy`, gives a hit, whose code is the low bits, 0 taken as 1.
    *Scene*: see `camera.sensor.scene`; in a sensor without one all codes are 0.

    Members
    -------
    port : In(SensorPort)
        The sensor port, from the side of the sensor.
    settings : In
        See `SYNTHETIC_LAYOUT`.
    began : In(1)
        A capture begins: the same codes come again.
    """

    def __init__(self, form: FrameFormat, scene: Scene | None = None) -> None:
        self.form = form
        self.scene = scene
        super().__init__(
            {
                "port": In(SensorPort(form)),
                "settings": In(SYNTHETIC_LAYOUT),
                "began": In(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        form = self.form
        lanes = range(form.lanes)
        settings = self.settings

        frame = Signal(form.code_bits)
        delay, delay_next = Signal(form.code_bits), Signal(form.code_bits)
        count = Signal(form.code_bits)  # code of the counter in lane 0
        running, last = Signal(), Signal()
        beat = Signal(range(form.beats))
        m.d.comb += last.eq(beat == form.beats - 1)
        with m.If(self.port.read):
            m.d.sync += [
                running.eq(1),
                beat.eq(0),
                count.eq(frame),
                frame.eq(frame + 1),
                delay.eq(delay_next),
                delay_next.eq(delay_next + settings.delay_step),
            ]
        with m.Elif(running):
            m.d.sync += [beat.eq(beat + 1), count.eq(count + form.lanes), running.eq(~last)]
        with m.If(self.began):
            m.d.sync += [frame.eq(0), delay_next.eq(settings.delay_start), running.eq(0)]

        state = [self._generator(m, lane, running) for lane in lanes]
        row_mark, block = self._position(m, running, last)
        flags = Cat(running, beat == 0, row_mark, last)
        for _ in range(LATENCY):
            later = Signal(len(flags))
            m.d.sync += later.eq(flags)
            flags = later
        out: stream.Interface = self.port.beats
        m.d.comb += Cat(out.valid, out.payload.first, out.payload.row, out.payload.last).eq(flags)

        scene = (
            self._scene(m, state, block, delay) if self.scene is not None else [0 for _ in lanes]
        )
        for lane in lanes:
            counted = _delayed(m, count + lane, form.code_bits, LATENCY - 1)
            drawn = Signal(form.code_bits, name=f"drawn{lane}")
            hit = Signal(name=f"hit{lane}")
            code = state[lane][: form.code_bits]
            m.d.sync += [
                drawn.eq(Mux(code == 0, 1, code)),
                hit.eq(state[lane][16:] < settings.occupancy),
            ]
            random = _delayed(m, Mux(hit, drawn, 0), form.code_bits, LATENCY - 2)
            with m.Switch(settings.source):
                with m.Case(SyntheticSource.COUNTER):
                    m.d.sync += out.payload.codes[lane].eq(counted)
                with m.Case(SyntheticSource.RANDOM):
                    m.d.sync += out.payload.codes[lane].eq(random)
                with m.Default():
                    m.d.sync += out.payload.codes[lane].eq(scene[lane])
        return m

    def _generator(self, m: Module, lane: int, step: Value) -> Signal:
        """Return the state of a lane's xorshift32, the one of Marsaglia's with 13, 17, 5."""
        state = Signal(32, name=f"state{lane}")
        a = state ^ (state << 13)[:32]
        b = a ^ (a >> 17)
        with m.If(step):
            m.d.sync += state.eq(b ^ (b << 5)[:32])
        with m.If(self.began):
            m.d.sync += state.eq((self.settings.seed ^ SEEDS[lane]) | 1)
        return state

    def _position(self, m: Module, running: Signal, last: Signal) -> tuple[Value, Value]:
        """Return whether a row begins in the beat, and the block of its first pixel."""
        form = self.form
        whole, part = divmod(form.lanes, form.cols)
        row, col = Signal(range(form.rows + whole + 1)), Signal(range(form.cols))
        with m.If(running):
            with m.If(col >= form.cols - part):
                m.d.sync += [col.eq(col + part - form.cols), row.eq(row + whole + 1)]
            with m.Else():
                m.d.sync += [col.eq(col + part), row.eq(row + whole)]
        with m.If((running & last) | self.began):
            m.d.sync += [row.eq(0), col.eq(0)]
        crosses = [(col > form.cols - used) for used in (form.lanes, form.last_lanes)]
        row_mark = (col == 0) | Mux(last, crosses[1], crosses[0])
        return row_mark, Cat(_block(col, form.cols), _block(row, form.rows))

    def _scene(self, m: Module, state: list[Signal], block: Value, delay: Signal) -> list[Value]:
        """Return codes of the scene, one clock less than `LATENCY` later."""
        form, scene = self.form, self.scene
        if scene is None:
            return [Const(0)] * form.lanes
        cell = data.StructLayout({"depth": DEPTH_BITS, "material": range(MATERIALS)})
        m.submodules.scene_map = cells = Memory(
            shape=cell, depth=1 << len(block), init=_cells(scene, form)
        )
        cell_port = cells.read_port()
        m.d.comb += cell_port.addr.eq(block)
        # one step a clock: block memories are slow
        cell2 = Signal(cell)
        shift = Signal(form.code_bits)
        m.d.sync += [cell2.eq(cell_port.data), shift.eq(cell2.depth + delay)]

        codes: list[Value] = []
        for lane, generator in enumerate(state):
            outcomes = Memory(
                shape=form.code_bits,
                depth=MATERIALS * OUTCOMES,
                init=[int(code) for code in scene.outcomes.reshape(-1)],
            )
            m.submodules[f"outcomes{lane}"] = outcomes
            port = outcomes.read_port()
            drawn = _delayed(m, generator[:8], 8, 2)
            m.d.comb += port.addr.eq(Cat(drawn, cell2.material))
            jitter = generator[8 : 8 + JITTER_BITS] + generator[16 : 16 + JITTER_BITS]
            late = _delayed(m, jitter, JITTER_BITS + 1, 3)
            drawn4, moved4 = Signal(form.code_bits), Signal(form.code_bits)
            code5, dark5 = Signal(form.code_bits), Signal()
            code6 = Signal(form.code_bits, name=f"scene_code{lane}")
            m.d.sync += [
                drawn4.eq(port.data),
                moved4.eq(shift + late),
                code5.eq(drawn4 - moved4),
                dark5.eq(drawn4 == 0),
                code6.eq(Mux(dark5, 0, Mux(code5 == 0, -1, code5))),
            ]
            codes.append(code6)
        return codes


def _block(place: Signal, count: int) -> Value:
    """Return the bits of a row or column that name its block."""
    return place[ceil_log2(BLOCK) : max(ceil_log2(count), ceil_log2(BLOCK))]


def _cells(scene: Scene, form: FrameFormat) -> list[dict[str, int]]:
    """Return the map as a memory has it, rows of blocks at powers of two."""
    rows, cols = scene.material.shape
    stride = 1 << max(0, ceil_log2(form.cols) - ceil_log2(BLOCK))
    table = [{"depth": 0, "material": 0} for _ in range(rows * stride)]
    for row in range(rows):
        for col in range(cols):
            table[row * stride + col] = {
                "depth": int(scene.depth[row, col]),
                "material": int(scene.material[row, col]),
            }
    return table


def _delayed(m: Module, value: Value, bits: int, clocks: int) -> Value:
    for _ in range(clocks):
        later = Signal(bits)
        m.d.sync += later.eq(value)
        value = later
    return value
