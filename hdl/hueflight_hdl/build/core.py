# SPDX-License-Identifier: Apache-2.0
"""The illuminator as vendor-neutral Verilog, with a testbench that checks itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from amaranth.back import verilog
from amaranth.hdl import ClockDomain, Module, Signal, Value
from amaranth.lib.wiring import In

from hueflight_protocol import control
from hueflight_protocol.illuminator_map import ARM_KEY

from ..illuminator.illuminator import Illuminator, IlluminatorConfig
from ..illuminator.pulse_generator.generator import PulseGenerator
from ..illuminator.pulse_generator.reference import (
    Choice,
    Pulse,
    Schedule,
    Train,
    limit,
    render,
)
from ..testbench.ticks import ticks_to_words
from ..toolchain import offer_yosys

NAME = "hueflight_illuminator"
_MEANINGS = {
    "pulse_clk": "clock of the pulse generator; everything below is in its domain unless stated",
    "sync_clk": "control clock, {ratio} times slower, from the same source",
    "rx": "serial line from the host, 8N1, {baud:.0f} baud; asynchronous",
    "tx": "serial line to the host; domain of sync_clk",
    "trigger": "samples of the trigger input in a clock, bit 0 earliest; asynchronous",
    "frame_sync": "from the camera; asynchronous",
    "levels": "LED outputs: {lanes} ticks for each channel, channel 0 in the lowest bits",
    "trigger_out": "trigger for a camera that follows: {lanes} ticks, bit 0 earliest",
    "marker": "marker of the running train",
    "missed": "high for 16 clocks after an ignored trigger",
    "armed": "LEDs may be on",
    "clock_failed": "the clocks are not valid: disarms; may rise at any time, falls with sync_clk",
}
_CLOCKS = 600
"""Clocks that the testbench compares."""
_TESTBENCH = """\
// Checks {name}.v: loads a schedule over the serial line, arms, sends a trigger, and compares every
// tick of every LED with expected.hex, which the reference model computed.
//
//   with Icarus: iverilog -g2005 -o test {name}.v testbench.v && vvp test
//   with Verilator: verilator --binary --timing -Wno-fatal --top-module testbench {name}.v
//       testbench.v && obj_dir/Vtestbench
//
// Prints PASS, or FAIL with the first clock that differs.
`timescale 1ps / 1ps

module testbench;
    localparam HALF = {half};  // of pulse_clk
    localparam BIT = {bit};  // of the serial line
    localparam BYTES = {count};

    reg pulse_clk = 0, sync_clk = 0, rx = 1;
    reg [{last_lane}:0] trigger = 0;
    wire [{last_level}:0] levels;
    wire armed;
    reg [7:0] requests [0:BYTES - 1];
    reg [{last_level}:0] expected [0:{last_clock}];
    integer edges = 0, at, place, lit = 0, wrong = 0;
    reg [9:0] frame;

    {name} dut (
        .pulse_clk(pulse_clk), .sync_clk(sync_clk), .rx(rx), .trigger(trigger),
        .frame_sync(1'b0), .clock_failed(1'b0), .levels(levels), .armed(armed)
    );

    always begin
        #HALF;
        if (edges % {twice} == 0) sync_clk = ~sync_clk;
        pulse_clk = ~pulse_clk;
        edges = edges + 1;
        if (edges == {four}) edges = 0;
    end

    initial begin
        $readmemh("requests.hex", requests);
        $readmemh("expected.hex", expected);
        #(BIT * 4);
        for (at = 0; at < BYTES; at = at + 1) begin
            frame = {{1'b1, requests[at], 1'b0}};
            for (place = 0; place < 10; place = place + 1) begin
                rx = frame[place];
                #BIT;
            end
            if (requests[at] == 0) #(BIT * {pause});  // the response
        end
        if (!armed) begin
            $display("FAIL: not armed");
            $finish;
        end
        @(negedge pulse_clk);
        trigger = {lanes}'d{first_word};
        @(negedge pulse_clk);
        trigger = -1;
        repeat ({latency}) @(negedge pulse_clk);
        for (at = 0; at <= {last_clock}; at = at + 1) begin
            if (at == 8) trigger = 0;
            if (levels !== expected[at]) begin
                if (wrong == 0)
                    $display("FAIL: clock %0d: %h, expected %h", at, levels, expected[at]);
                wrong = wrong + 1;
            end
            if (levels != 0) lit = lit + 1;
            @(negedge pulse_clk);
        end
        if (wrong == 0 && lit > 0) $display("PASS: %0d clocks with light", lit);
        else $display("FAIL: %0d clocks differ, %0d have light", wrong, lit);
        $finish;
    end
endmodule
"""


def write_core(config: IlluminatorConfig, folder: Path, /) -> list[Path]:
    """Write the illuminator as one Verilog file without vendors' primitives, and its testbench.

    Parameters
    ----------
    config : IlluminatorConfig
        What is built.
    folder : Path
        Output folder; it is created if needed.

    Returns
    -------
    list of Path
        The files that were written: Verilog, testbench, its data, and the list of ports.

    Raises
    ------
    ToolError
        If yosys, which converts RTLIL to Verilog, is not installed.
    """
    offer_yosys()
    folder.mkdir(parents=True, exist_ok=True)
    top, ports = _top(config)
    text = verilog.convert(
        top,
        name=NAME,
        ports={name: (signal, None) for name, (signal, _) in ports.items()},
        emit_src=False,
        strip_internal_attrs=True,
    )
    requests, expected = _requests(config), _expected(config)
    digits = -(-config.pulse.channels * config.pulse.lanes // 4)
    files = {
        f"{NAME}.v": text,
        "testbench.v": _testbench(config, len(requests)),
        "requests.hex": "".join(f"{byte:02x}\n" for byte in requests),
        "expected.hex": "".join(f"{word:0{digits}x}\n" for word in expected),
        "ports.md": _port_list(config, ports),
    }
    for name, content in files.items():
        (folder / name).write_text(content)
    return [folder / name for name in files]


def _top(config: IlluminatorConfig) -> tuple[Module, dict[str, tuple[Signal, bool]]]:
    """Return the module with its clocks, and its ports: signal and whether it is an input."""
    m = Module()
    m.submodules.illuminator = illuminator = Illuminator(config)
    ports: dict[str, tuple[Signal, bool]] = {}
    for domain in ("pulse", "sync"):
        m.domains += (made := ClockDomain(domain, reset_less=True))
        ports[f"{domain}_clk"] = (made.clk, True)
    for path, member, value in illuminator.signature.flatten(illuminator):
        signal = Value.cast(value)
        if isinstance(signal, Signal) and len(signal):
            ports["__".join(map(str, path))] = (signal, member.flow is In)
    return m, ports


def _pulses(config: IlluminatorConfig) -> list[Pulse]:
    """Return a pulse for each channel, one after another: a clock and a tick long if allowed."""
    width = min(config.pulse.lanes + 1, config.pulse.limit(0).max_on_ticks)
    return [Pulse(3 * width * channel, width) for channel in range(config.pulse.channels)]


def _requests(config: IlluminatorConfig) -> bytes:
    """Return what the testbench sends: schedule, then arming."""
    registers = config.registers()
    writes = [
        (registers["pulse"].address_of(0, channel, 0), pulse.delay | pulse.width << 16)
        for channel, pulse in enumerate(_pulses(config))
    ]
    writes.append((registers["bank_period"].address_of(0), _CLOCKS * config.pulse.lanes // 2))
    writes.append((registers["bank_enable"].address_of(0), (1 << config.pulse.channels) - 1))
    writes.append((registers["arm"].address, ARM_KEY))
    return b"".join(
        control.serial_frame(control.encode_request(control.write(number, address, [word])))
        for number, (address, word) in enumerate(writes)
    )


def _first_tick(config: IlluminatorConfig) -> int:
    """Return the tick of the trigger's edge in its clock."""
    return config.pulse.lanes // 2


def _expected(config: IlluminatorConfig) -> list[int]:
    """Return the word of all levels for each clock from that of the trigger's pulses on."""
    pulse, ticks = config.pulse, _CLOCKS * config.pulse.lanes
    schedule = Schedule(
        ticks // 2,
        (1 << pulse.channels) - 1,
        [[one] + [Pulse(0, 0)] * (pulse.pulses - 1) for one in _pulses(config)],
    )
    train = Train(_first_tick(config), Choice(0), restarted=False)
    words = [0] * _CLOCKS
    for channel in range(pulse.channels):
        demand = render(
            [train],
            [schedule, schedule],
            channel=channel,
            lanes=pulse.lanes,
            ticks=ticks,
            widest=pulse.widest,
        )
        level = limit(demand, pulse.limit(channel), lanes=pulse.lanes)
        for clock, word in enumerate(ticks_to_words(np.asarray(level), lanes=pulse.lanes)):
            words[clock] |= int(word) << channel * pulse.lanes
    return words


def _testbench(config: IlluminatorConfig, count: int) -> str:
    lanes = config.pulse.lanes
    half = round(0.5e12 / config.pulse_hz)
    first = _first_tick(config)
    return _TESTBENCH.format(
        name=NAME,
        half=half,
        bit=round(1e12 / config.baud),
        count=count,
        lanes=lanes,
        last_lane=lanes - 1,
        last_level=lanes * config.pulse.channels - 1,
        last_clock=_CLOCKS - 1,
        twice=config.clock_ratio,
        four=2 * config.clock_ratio,
        pause=10 * 24,
        first_word=((1 << lanes) - 1) >> first << first,
        latency=PulseGenerator.latency - 1,
    )


def _port_list(config: IlluminatorConfig, ports: dict[str, tuple[Signal, bool]]) -> str:
    """Return the ports as a table in Markdown."""
    lines = [f"# Ports of {NAME}", "", "| port | direction | bits | meaning |", "|---|---|---|---|"]
    facts = {"ratio": config.clock_ratio, "baud": config.baud, "lanes": config.pulse.lanes}
    for name, (signal, is_input) in ports.items():
        direction = "input" if is_input else "output"
        lines.append(
            f"| {name} | {direction} | {len(signal)} | {_MEANINGS[name].format(**facts)} |"
        )
    lines += [
        "",
        f"A tick is {config.tick_fs / 1e6:g} ns. A pulse without delay begins "
        f"{PulseGenerator.latency} clocks after the clock of its trigger's sample.",
        "",
        "Simulators must read the Verilog as that of 2005. As SystemVerilog, its combinational "
        "blocks without inputs that change are never evaluated.",
    ]
    return "\n".join(lines) + "\n"
