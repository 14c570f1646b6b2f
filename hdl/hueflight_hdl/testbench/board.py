# SPDX-License-Identifier: Apache-2.0
"""A whole generated top, with models of the vendor's primitives, in Verilator.

Everything in a bitstream of a board is simulated: clocks and PLL, I/O registers, serial line, and
an illuminator, or a camera with an external clock and an FT601. A run takes a list of commands and
returns the changes of the pins in picoseconds.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import tempfile
from bisect import bisect_right
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hueflight_protocol.cobs import cobs_decode
from hueflight_protocol.control import Response, decode_response, serial_frame
from hueflight_protocol.errors import HueflightError

from ..toolchain import cache_directory, run_tool
from .serial_line import LineReader

MODELS = Path(__file__).parent / "models"
FAMILIES = ("ecp5", "ice40", "xc7")
BAUD = 3e6
_SAMPLES_PER_BIT = 16
_RECEIVE_PS = 20_000_000
"""After which a driver that waits for a message looks again."""
_OPTIONS = ("--cc", "--exe", "--build", "--timing", "-Wno-fatal", "-Wno-lint", "-Wno-style")
_WRAPPER = """\
module board (
    input osc, rx, trigger, external_clock, output [{last}:0] led, output tx, clock_out
);
    // pins of some families are bidirectional, which takes nets
    wire osc_pin, rx_pin, trigger_pin, sync_pin, tx_pin, reference_pin, clock_out_pin;
    wire [{last}:0] led_pins;
    assign osc_pin = osc;
    assign rx_pin = rx;
    assign trigger_pin = trigger;
    assign sync_pin = 1'b0;
    assign led = led_pins;
    assign tx = tx_pin;
    assign reference_pin = external_clock;
    assign clock_out = clock_out_pin;
    top top ({more}
        .{clock}(osc_pin),
        .uart_0__rx__io(rx_pin),
        .uart_0__tx__io(tx_pin),
        .trigger_0__io(trigger_pin),
        .led_pulse_0__io(led_pins),
        .frame_sync_0__io(sync_pin)
    );
endmodule
"""

_CAMERA = """\
module board (
    input osc, rx, trigger, external_clock, output led, output tx, clock_out
);
    // the chip takes every word; its clock has another frequency than the board's
    reg ft = 0;
    wire wr_n;
    wire [31:0] data;
    always #{ft_half} ft = ~ft;
    always @(negedge ft) if (!wr_n) $display("%0d word %0d", $time, data);
    top top (
        .{clock}(osc),
        .uart_0__rx__io(rx),
        .uart_0__tx__io(tx),
        .reference_0__io(external_clock),
        .clock_out_0__io(clock_out),
        .time_sync_0__io(trigger),
        .frame_sync_0__io(led),
        .marker_0__io(8'b0),
        .missed_0__io(1'b0),
        .ft601_0__clk__io(ft),
        .ft601_0__txe_n__io(1'b0),
        .ft601_0__wr_n__io(wr_n),
        .ft601_0__data__io(data)
    );
endmodule
"""
_FT_HALF_PS = 5003


class BoardError(HueflightError):
    """A generated top cannot be simulated, or its simulation failed."""


@dataclass
class BoardScript:
    """Commands for a simulated board, in order.

    Attributes
    ----------
    lines : list of str
        Commands, as ``board_main.cc`` lists them.
    now_ps : int
        Time at which the next command takes effect.
    """

    lines: list[str] = field(default_factory=list)
    now_ps: int = 0

    def wait(self, ps: int, /) -> None:
        """Let time pass."""
        self.lines.append(f"wait {ps}")
        self.now_ps += ps

    def send(self, frame: bytes, /) -> None:
        """Send bytes on the serial line."""
        bit = round(1e12 / BAUD)
        self.lines.append(f"send {frame.hex()} {bit}")
        self.now_ps += 10 * len(frame) * bit

    def set(self, name: str, value: int, /) -> None:
        """Set an input: ``trigger`` and ``osc`` to a level, ``pll`` to a mode of its model.

        ``reference`` takes the half period of the external clock in picoseconds, 0 to stop it;
        ``period`` 0 notes that of the clock output.
        """
        self.lines.append(f"{name} {value}")


@dataclass(frozen=True)
class BoardRun:
    """What a board did.

    Attributes
    ----------
    led : list of (int, int)
        Changes of the LED pins: time in picoseconds, and a bit for each channel; of a camera,
        those of its frame sync.
    tx : list of (int, int)
        Changes of the serial output.
    end_ps : int
        Time at the end.
    periods : list of (int, int)
        Time, and last period of the clock output in picoseconds, at each ``period``.
    words : list of (int, int)
        Words of four bytes that a camera's link took.
    """

    led: list[tuple[int, int]]
    tx: list[tuple[int, int]]
    end_ps: int
    periods: list[tuple[int, int]] = field(default_factory=list)
    words: list[tuple[int, int]] = field(default_factory=list)

    def pulses(self, channel: int, start_ps: int, stop_ps: int, /) -> list[tuple[int, int]]:
        """Return when a channel's LED goes on within a window, and for how long, in ps."""
        found, on = [], None
        for time, levels in [*self.led, (self.end_ps, 0)]:
            lit = levels >> channel & 1
            if lit and on is None:
                on = time
            elif not lit and on is not None:
                if start_ps <= on < stop_ps:
                    found.append((on, time - on))
                on = None
        return found

    def responses(self) -> list[Response]:
        """Return the responses that the board sent."""
        step = 1e12 / BAUD / _SAMPLES_PER_BIT
        times = [time for time, _ in self.tx]
        levels = [
            self.tx[max(bisect_right(times, int(number * step)) - 1, 0)][1]
            for number in range(int(self.end_ps / step))
        ]
        # before the first change and while the board starts, the line rests
        line = np.array(levels, np.uint8)
        data = LineReader(clocks_per_bit=_SAMPLES_PER_BIT).feed(line)
        return [decode_response(cobs_decode(part)) for part in data.split(b"\0") if part]


def compile_board(verilog: Path, /, *, oscillator_hz: float, family: str = "ecp5") -> Path:
    """Compile a generated top with the models of primitives; the result is cached.

    Parameters
    ----------
    verilog : Path
        ``top.v`` of an illuminator, or of a camera as above, whose ``trigger`` is its input
        ``time_sync``.
    oscillator_hz : float
        Frequency of the board's oscillator.
    family : str
        Family of the FPGA, one of `FAMILIES`.

    Returns
    -------
    Path
        A program for `run_board`.

    Raises
    ------
    ToolError
        If Verilator is not installed or fails.
    BoardError
        If there are no models of the family, or the top does not have the pins of either.
    """
    if family not in FAMILIES:
        raise BoardError(f"{family}: there are models of {', '.join(FAMILIES)}")
    text = verilog.read_text()
    wrapper = _wrapper(verilog, text)
    half = round(0.5e12 / oscillator_hz)
    sources = [MODELS / f"{family}.sv", MODELS / "board_main.cc"]
    digest = hashlib.sha256("\0".join((text, wrapper, str(half), *_OPTIONS)).encode())
    for source in sources:
        digest.update(source.read_bytes())
    folder = cache_directory() / "verilator"
    kept = folder / digest.hexdigest()[:32]
    if kept.exists():
        return kept
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as made:
        work = Path(made)
        (work / "top.v").write_text(text)
        (work / "board.sv").write_text(wrapper)
        for source in sources:
            shutil.copyfile(source, work / source.name)
        names = ("top.v", "board.sv", *(source.name for source in sources))
        flags = f"-O1 -DOSC_HALF_PS={half}"
        timing = ("--timescale", "1ps/1ps", "--top-module", "board", "-CFLAGS", flags)
        run_tool("verilator", *_OPTIONS, *timing, "--Mdir", "obj", "-o", "board", *names, cwd=work)
        (work / "obj" / "board").replace(kept)
    return kept


def run_board(program: Path, script: BoardScript, /) -> BoardRun:
    """Run a compiled board.

    Parameters
    ----------
    program : Path
        From `compile_board`.
    script : BoardScript
        What happens to the board.

    Returns
    -------
    BoardRun
        What its pins did.

    Raises
    ------
    BoardError
        If the simulation fails.
    """
    finished = subprocess.run(
        [program], input="\n".join(script.lines), capture_output=True, text=True, check=False
    )
    if finished.returncode:
        raise BoardError(f"the simulation of {program} failed: {finished.stderr[-500:]}")
    changes: dict[str, list[tuple[int, int]]] = {"led": [], "tx": [], "period": [], "word": []}
    for line in finished.stdout.splitlines():
        time, name, value = line.split()
        changes[name].append((int(time), int(value)))
    return BoardRun(
        changes["led"], changes["tx"], script.now_ps, changes["period"], changes["word"]
    )


class BoardProcess:
    """A board that runs as it is asked: a `Transport` for the illuminator's driver.

    Simulated time passes only while something is sent or received.

    Parameters
    ----------
    program : Path
        From `compile_board`.

    Attributes
    ----------
    name : str
        See `Transport`.
    """

    def __init__(self, program: Path, /) -> None:
        self.name = "simulated board"
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._reader = LineReader(clocks_per_bit=_SAMPLES_PER_BIT)
        self._messages: list[bytes] = []
        self._received = b""
        self._level = 1
        self._samples = 0

    def run(self, script: BoardScript, /) -> None:
        """Run commands.

        Parameters
        ----------
        script : BoardScript
            What happens to the board.

        Raises
        ------
        BoardError
            If the simulation has ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write("\n".join([*script.lines, "flush 0", ""]))
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise BoardError(f"{self.name}: the simulation has ended") from error
        for line in self._process.stdout:
            time, name, value = line.split()
            if name in ("tx", "now"):
                self._take(int(time))
            if name == "tx":
                self._level = int(value)
            if name == "now":
                return
        raise BoardError(f"{self.name}: the simulation has ended")

    def send(self, message: bytes, /) -> None:
        """Send one request, see `Transport`."""
        script = BoardScript()
        script.send(serial_frame(message))
        self.run(script)

    def receive(self, timeout_s: float, /) -> bytes | None:
        """Return the next message within so much simulated time, see `Transport`."""
        script = BoardScript()
        script.wait(_RECEIVE_PS)
        for _ in range(max(1, round(timeout_s * 1e12 / _RECEIVE_PS))):
            if self._messages:
                break
            self.run(script)
        return self._messages.pop(0) if self._messages else None

    def close(self) -> None:
        """End the simulation."""
        self._process.communicate()  # the end of its commands is its end

    def _take(self, time_ps: int) -> None:
        """Sample the line up to a time, at its level since the last change."""
        samples = int(time_ps * BAUD * _SAMPLES_PER_BIT / 1e12)
        self._received += self._reader.feed(np.full(samples - self._samples, self._level, np.uint8))
        self._samples = samples
        *whole, self._received = self._received.split(b"\0")
        self._messages += [cobs_decode(part) for part in whole if part]


def _wrapper(verilog: Path, text: str) -> str:
    """Return the module around a top, by its pins."""
    clock = re.search(r"(?:input|inout) ((?:clk|clock)\w*__io);", text)
    leds = re.search(r"(?:output|inout) \[(\d+):0\] led_pulse_0__io;", text)
    if clock is None or (leds is None and " ft601_0__wr_n__io;" not in text):
        raise BoardError(
            f"{verilog}: has no clock, or neither the led_pulse pins of an illuminator nor a "
            "camera's FT601"
        )
    if leds is None:
        return _CAMERA.format(clock=clock[1], ft_half=_FT_HALF_PS)
    more = "".join(
        f"\n        .{name}_0__io({name}_pin),"
        for name in ("reference", "clock_out")
        if f" {name}_0__io;" in text
    )
    return _WRAPPER.format(last=leds[1], clock=clock[1], more=more)
