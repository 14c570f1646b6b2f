# SPDX-License-Identifier: Apache-2.0
"""One LED train of the simulated illuminator, as VCD files and as a drawing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from vcd import VCDWriter
from vcd.gtkw import GTKWSave

from ..illuminator.gearing.ecp5 import Ecp5Gearing
from ..illuminator.gearing.interface import Gearing
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.config import PulseConfig
from ..illuminator.pulse_generator.reference import Pulse, Schedule
from .cxxrtl import SimulationError
from .illuminator_trials import Trial, TrialTestbench
from .signal_dump import dump_signals, find_signals

TABLE_1 = Schedule(256, 0x1FF, [[Pulse(24 * channel, 8)] for channel in range(9)])
"""The paper's schedule in ticks of 1.25 ns: 10 ns wide, 30 ns apart, every 320 ns (its Table 1)."""
_LEAD_CLOCKS = 600
"""For the request that arms."""
_TOP_SCOPE = "bench.top"
_SHOWN_SCOPES = [
    _TOP_SCOPE + within
    for within in ("", ".core.generator", ".core.generator.sequencer", ".core.generator.channel0")
]


@dataclass(frozen=True)
class Waveform:
    """Levels of pins in equal steps of time.

    Parameters
    ----------
    tick_ns : float
    pins : dict of str to numpy.ndarray of bool, shape (ticks,)
    """

    tick_ns: float
    pins: dict[str, np.ndarray]


def record_train(
    config: IlluminatorConfig | None = None,
    gearing: Gearing | None = None,
    schedule: Schedule = TABLE_1,
    *,
    phase: int = 0,
) -> Waveform:
    """Simulate an illuminator from pin to pin for one train.

    Parameters
    ----------
    config : IlluminatorConfig, optional
        By default the paper's nine channels, 200 MHz, four lanes.
    gearing : Gearing, optional
        Gearing whose model is simulated; by default that of the ECP5.
    schedule : Schedule
    phase : int
        Lane of the trigger.

    Returns
    -------
    Waveform
        From shortly before the trigger to the end of its train; pins ``trigger``, ``armed`` and
        ``led0`` and so on.
    """
    bench = _bench(config, gearing)
    return _record_train(bench, schedule, phase)


def dump_train(
    folder: Path,
    config: IlluminatorConfig | None = None,
    gearing: Gearing | None = None,
    schedule: Schedule = TABLE_1,
) -> tuple[Path, Path]:
    """Simulate an illuminator for one train, and write all signals of its gateware.

    Parameters
    ----------
    folder : Path
        Where to write: ``signals.vcd``, from the configuration on, and ``signals.gtkw``, which
        shows pins, pulse generator, sequencer and first channel while the train lasts.
    config, gearing, schedule
        As for `record_train`.

    Returns
    -------
    dump, save : Path
        The two files.

    Raises
    ------
    SimulationError
        If Amaranth's simulator and the compiled design do not have the same outputs.
    """
    bench = _bench(config, gearing, record=True)
    waveform = _record_train(bench, schedule, 0)
    clock_s = 1 / bench.config.pulse_hz
    inputs, outputs = (np.concatenate(part) for part in zip(*bench.recorded, strict=True))
    dump, save = folder / "signals.vcd", folder / "signals.gtkw"
    levels = dump_signals(bench.design(), inputs, dump, clocks=bench.clocks, clock_s=clock_s)
    if any((level != outputs[name]).any() for name, level in levels.items()):
        raise SimulationError("the two simulators differ: report it with the configuration")
    shown_ps = len(waveform.pins["trigger"]) * waveform.tick_ns * 1000
    end_ps = len(inputs) * clock_s * 1e12
    with save.open("w") as file:
        made = GTKWSave(file)
        made.dumpfile(dump.name, abspath=False)
        made.zoom_markers(zoom=-math.log2(shown_ps / _VIEW_PIXELS))
        made.timestart(round(end_ps - shown_ps))
        for name in find_signals(dump, _SHOWN_SCOPES):
            made.trace(name)
    return dump, save


def _bench(
    config: IlluminatorConfig | None, gearing: Gearing | None, *, record: bool = False
) -> TrialTestbench:
    config = config or IlluminatorConfig(PulseConfig(pulses=1, steps=1))
    return TrialTestbench(config, gearing or Ecp5Gearing(), record=record)


def _record_train(bench: TrialTestbench, schedule: Schedule, phase: int) -> Waveform:
    lanes = bench.config.pulse.lanes
    late = bench.latency_clocks * lanes
    trigger = np.zeros(_LEAD_CLOCKS * lanes + schedule.period + 4 * late, bool)
    at = _LEAD_CLOCKS * lanes + phase
    trigger[at : at + 8] = True
    shot = bench.play(Trial((schedule, schedule), trigger))
    window = slice(at - 8, at + late + schedule.period + 8)

    def pin(levels: np.ndarray) -> np.ndarray:
        return np.concatenate((np.zeros(late, bool), levels))[window]

    pins = {"trigger": trigger[window], "armed": pin(shot.armed)}
    pins |= {f"led{channel}": pin(level) for channel, level in enumerate(shot.levels)}
    return Waveform(bench.config.tick_fs * 1e-6, pins)


def write_vcd(waveform: Waveform, path: Path, /) -> None:
    """Write a waveform as a value change dump (IEEE 1364-2005, clause 18), in picoseconds."""
    with path.open("w") as file, VCDWriter(file, timescale="1 ps", date="") as writer:
        signals = {
            name: writer.register_var("illuminator", name, "wire", size=1, init=int(level[0]))
            for name, level in waveform.pins.items()
        }
        ticks = len(next(iter(waveform.pins.values())))
        for tick in range(1, ticks):
            now = round(tick * waveform.tick_ns * 1000)
            for name, level in waveform.pins.items():
                if level[tick] != level[tick - 1]:
                    writer.change(signals[name], now, int(level[tick]))
        writer.close(round(ticks * waveform.tick_ns * 1000))


def write_save_file(waveform: Waveform, dump: Path, path: Path, /) -> None:
    """Write a save file of GTKWave: the pins of a waveform in their order, all of it in view.

    Parameters
    ----------
    waveform : Waveform
        What `write_vcd` wrote.
    dump : Path
        The VCD file, in the same folder.
    path : Path
        File to write.
    """
    ticks = len(next(iter(waveform.pins.values())))
    last_ps = ticks * waveform.tick_ns * 1000
    with path.open("w") as file:
        save = GTKWSave(file)
        save.dumpfile(dump.name, abspath=False)
        save.zoom_markers(zoom=-math.log2(last_ps / _VIEW_PIXELS))  # all of it in view
        for name in waveform.pins:
            save.trace(f"illuminator.{name}")


_VIEW_PIXELS = 1000
_LEFT, _WIDTH, _ROW, _HIGH, _TOP = 76, 760, 34, 20, 20
_STYLE = """\
text { font: 12px system-ui, sans-serif; fill: #333 }
.grid { stroke: #8886; stroke-width: 1; stroke-dasharray: 2 4 }
.level { stroke: #1f6feb; stroke-width: 1.6; fill: #1f6feb33 }
.trigger { stroke: #c2410c; stroke-width: 1.6; fill: #c2410c33 }
@media (prefers-color-scheme: dark) { text { fill: #ccc } }"""


def draw(waveform: Waveform, path: Path, /) -> None:
    """Draw the trigger and the LEDs over time since the trigger as an SVG.

    Each pulse is marked with when it begins after the first LED's, and how long it lasts.
    """
    tick = waveform.tick_ns
    trigger = waveform.pins["trigger"]
    shown = {name: level for name, level in waveform.pins.items() if name != "armed"}
    origin = int(np.flatnonzero(trigger)[0])
    span = len(trigger) * tick

    def x(ticks: float) -> float:
        return _LEFT + ticks * tick / span * _WIDTH

    bottom = _TOP + _ROW * len(shown)
    size = f"{_LEFT + _WIDTH + 16} {bottom + 36}"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" role="img" '
        f'aria-label="Levels of {escape(", ".join(shown))} over time">',
        f"<style>{_STYLE}</style>",
    ]
    for time in range(0, int(span - origin * tick) + 1, 40):
        at = x(origin + time / tick)
        parts += [
            f'<path class="grid" d="M{at:.1f} {_TOP - 8}V{bottom}"/>',
            f'<text x="{at:.1f}" y="{bottom + 16}" text-anchor="middle">{time}</text>',
        ]
    parts.append(
        f'<text x="{_LEFT + _WIDTH / 2}" y="{bottom + 32}" text-anchor="middle">'
        "ns after the trigger</text>"
    )
    first = min((int(np.flatnonzero(level)[0]) for name, level in shown.items()
                 if name != "trigger" and level.any()), default=origin)  # fmt: skip
    for row, (name, level) in enumerate(shown.items()):
        base = _TOP + _ROW * row + _HIGH + 6
        label = name.replace("led", "LED ")
        parts.append(f'<text x="{_LEFT - 10}" y="{base - 4}" text-anchor="end">{label}</text>')
        change = np.diff(np.concatenate(([0], level.astype(int), [0])))
        rises, falls = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
        line = f"M{_LEFT} {base}"
        for rise, fall in zip(rises, falls, strict=True):
            line += f"H{x(rise):.1f}V{base - _HIGH}H{x(fall):.1f}V{base}"
            if name != "trigger":
                told = f"{(rise - first) * tick:g} + {(fall - rise) * tick:g} ns"
                end = fall + 3 if x(fall) < _LEFT + _WIDTH - 100 else rise - 3
                anchor = "start" if end > fall else "end"
                parts.append(
                    f'<text x="{x(end):.1f}" y="{base - 6}" text-anchor="{anchor}">{told}</text>'
                )
        kind = "trigger" if name == "trigger" else "level"
        parts.append(f'<path class="{kind}" d="{line}H{_LEFT + _WIDTH}"/>')
    path.write_text("\n".join([*parts, "</svg>"]) + "\n")
