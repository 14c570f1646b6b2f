# SPDX-License-Identifier: Apache-2.0
"""Every signal of a design over time, also inner ones, as a VCD file for a waveform viewer.

Compiled simulation has the ports alone. What went into it is played again in Amaranth's simulator,
which knows all signals by their names in the source.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from amaranth.lib import wiring
from amaranth.sim import Simulator

from .cxxrtl import design_ports


def dump_signals(
    design: wiring.Component,
    inputs: np.ndarray,
    path: Path,
    /,
    *,
    clocks: Mapping[str, int],
    clock_s: float,
) -> dict[str, np.ndarray]:
    """Play the inputs of a batch again, and write all signals of the design.

    Parameters
    ----------
    design : Component
        What was compiled, not elaborated yet.
    inputs : numpy.ndarray, shape (clocks,)
        Records of all clocks since configuration, as `cxxrtl.Simulation.run` took them.
    path : Path
        VCD file to write.
    clocks : mapping of str to int
        As in `cxxrtl.compile_design`.
    clock_s : float
        Period of the fastest domain, in seconds.

    Returns
    -------
    dict of str to numpy.ndarray, shape (clocks,)
        Level of each output in each clock, to compare with the compiled design.
    """
    simulator = Simulator(design)
    for domain, ratio in clocks.items():
        simulator.add_clock(clock_s * ratio, phase=clock_s / 2, domain=domain)
    fastest = min(clocks, key=clocks.__getitem__)
    ports = list(design_ports(design))
    driven = [(port.name, signal) for port, signal in ports if port.is_input]
    outputs = [(port.name, signal) for port, signal in ports if not port.is_input]
    levels = {name: np.zeros(len(inputs), object) for name, _ in outputs}

    async def drive(ctx) -> None:  # type: ignore[no-untyped-def]
        for clock, record in enumerate(inputs):
            for name, signal in driven:
                ctx.set(signal, int.from_bytes(record[name].tobytes(), "little"))
            for name, signal in outputs:
                levels[name][clock] = ctx.get(signal)
            await ctx.tick(fastest)

    simulator.add_testbench(drive)
    with simulator.write_vcd(str(path)):
        simulator.run()
    return levels


def find_signals(dump: Path, scopes: Sequence[str], /) -> Iterator[str]:
    """Return the full names of the signals in some scopes of a dump, in the order of the scopes.

    Signals of one name have a number behind ``$``; only the first of them is returned.

    Parameters
    ----------
    dump : Path
        A VCD file.
    scopes : sequence of str
        Full names, such as ``bench.top.core``; scopes within them are not included.
    """
    found: dict[str, list[str]] = {scope: [] for scope in scopes}
    within: list[str] = []
    with dump.open() as lines:
        for line in lines:  # of one declaration each, as Amaranth writes them
            if scope := re.match(r"\$scope \w+ (\S+) \$end", line):
                within.append(scope[1])
            elif line.startswith("$upscope"):
                within.pop()
            elif line.startswith("$enddefinitions"):
                break
            elif (name := re.match(r"\$var \w+ \d+ \S+ \\?([^$]+) \$end", line)) and (
                (scope_name := ".".join(within)) in found
            ):
                found[scope_name].append(f"{scope_name}.{name[1].replace(' ', '')}")
    for names in found.values():
        yield from names
