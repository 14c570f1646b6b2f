# SPDX-License-Identifier: Apache-2.0
"""The illuminator's driver on a serial port of the operating system: a pseudo terminal."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest
import serial

import hueflight as hf
from hueflight.devices import (
    DeviceBusyError,
    DeviceError,
    DeviceGoneError,
    DeviceNotFoundError,
    DeviceTimeoutError,
    RequestError,
    WrongDeviceError,
)
from hueflight.devices.board import Board
from hueflight.devices.illuminator import Illuminator, open_illuminator
from hueflight.devices.illuminator_driver import IlluminatorDriver
from hueflight.devices.pulse_schedule import PulseSchedule
from hueflight.devices.sequencer_program import ProgramStep, each_alone
from hueflight.devices.transports.replay import ReplayTransport
from hueflight.devices.transports.serial import SerialPort, SerialTransport, find_baud
from hueflight_protocol import encode_request, serial_frame
from hueflight_protocol.control import MAX_COBS_BYTES, write
from hueflight_protocol.illuminator_map import TriggerSource
from hueflight_protocol.typed_registers import illuminator as registers

from .conftest import PtyBoard

WAIT_S = 60.0


@pytest.fixture
def driver(line: PtyBoard) -> Iterator[Illuminator]:
    driver = Illuminator(SerialTransport(SerialPort(line.path)), timeout_s=WAIT_S)
    yield driver
    driver.board.close()


def test_who_is_there(driver: Illuminator, line: PtyBoard):
    assert driver.identity.serial == "000000000000BEEF"
    assert driver.identity.place == line.path
    assert (driver.capacity.channels, driver.capacity.pulses) == (9, 4)
    assert driver.capacity.tick_ns == 1.25
    opened = line.board.registers.get("requests")
    assert opened > 3


def test_the_papers_schedule_arrives_in_ticks(driver: Illuminator, line: PtyBoard):
    made = driver.play(PulseSchedule.even(9))
    assert made.delay_error_ns == made.width_error_ns == made.period_error_ns == 0
    registers = line.board.registers
    map_ = registers.registers
    found = [map_["pulse"].decode(registers.get("pulse", 1, k, 0)) for k in range(9)]
    assert [pulse["delay"] for pulse in found] == list(range(0, 216, 24))
    assert {pulse["width"] for pulse in found} == {8}
    assert all(registers.get("pulse", 1, k, slot) == 0 for k in range(9) for slot in (1, 2, 3))
    assert registers.get("bank_enable", 1) == 0x1FF
    assert registers.get("bank_select") == 1


def test_arming_and_a_bank_in_use(driver: Illuminator, line: PtyBoard):
    driver.play(PulseSchedule.even(9))
    assert not driver.state().armed
    driver.arm(watchdog_ms=50)
    assert driver.state().armed
    assert line.board.registers.get("watchdog_ms") == 50
    with pytest.raises(RequestError, match="REFUSED"):
        driver.load(PulseSchedule.even(9), bank=1)
    driver.load(PulseSchedule.even(9), bank=0)
    driver.disarm()
    driver.load(PulseSchedule.even(9), bank=1)


def test_triggers_and_programs(driver: Illuminator, line: PtyBoard):
    assert driver.set_trigger(TriggerSource.INTERNAL, period_ns=321.0) == 321.25
    driver.clear()
    for _ in range(3):
        driver.trigger_now()
    assert driver.counters().served == 3
    driver.run(each_alone(9, 100, idle=1))
    assert driver.state().sequencing
    registers = line.board.registers
    assert [registers.get("step_mask", step) for step in range(9)] == [1 << k for k in range(9)]
    assert {registers.get("step_count", step) for step in range(9)} == {100}
    driver.run([ProgramStep(5)])  # stops the one before
    driver.stop()
    assert not driver.state().sequencing


def test_lights_of_a_capture(driver: Illuminator, line: PtyBoard):
    lights = IlluminatorDriver(driver, hf.Instrument.load("paper"))
    assert lights.schedule.period == 256
    lights.prepare("bands", 10)
    assert line.board.state("armed")
    assert line.board.state("sequencing")
    lights.prepare("dark", 10)
    assert not line.board.state("armed")
    lights.prepare("scene", 10)
    lights.keep_alive()
    assert line.board.state("armed")
    lights.close()
    assert not line.board.state("armed")


def test_noise_between_and_within_answers(driver: Illuminator, line: PtyBoard):
    """What comes unasked is passed over; an answer that was damaged is asked for again."""
    line.write(bytes(range(1, 200)) + b"\0")
    line.write(b"\x05hello\0\0\0")
    assert driver.board.read(registers.Scratch).value == 0
    number = count()
    line.spoil = lambda frame: (
        bytes([frame[0], frame[1] ^ 0x40, *frame[2:]]) if next(number) == 0 else frame
    )
    impatient = Board(driver.board.transport, driver.board.registers, timeout_s=0.3)
    impatient.write(registers.Scratch(77))
    assert impatient.read(registers.Scratch).value == 77
    assert next(number) > 1


def test_damaged_requests_change_nothing(driver: Illuminator, line: PtyBoard):
    driver.board.write(registers.Scratch(5))
    address = registers.Scratch.ADDRESS
    good = encode_request(write(9, address, [6]))
    transport = driver.board.transport
    assert isinstance(transport, SerialTransport)
    before = driver.board.read(registers.RequestErrors)
    port = transport._line
    port.write(b"\0" + serial_frame(good[:-1] + bytes([good[-1] ^ 1])))  # bad CRC
    port.write(serial_frame(good[:-3]))  # cut
    port.write(b"\x09abc\0")  # bad COBS
    port.write(bytes([1]) * (MAX_COBS_BYTES + 50) + b"\0")  # too long
    assert driver.board.read(registers.Scratch).value == 5
    after = driver.board.read(registers.RequestErrors)
    assert after.crc - before.crc == 1
    assert after.framing - before.framing == 3


def test_silence_names_the_request(line: PtyBoard):
    line.spoil = lambda frame: b""
    with pytest.raises(DeviceTimeoutError, match=line.path):
        open_illuminator(line.path)
    line.spoil = lambda frame: frame


def test_unplugged(driver: Illuminator, line: PtyBoard):
    line.close()
    with pytest.raises(DeviceGoneError, match="unplugged"):
        driver.state()


def test_another_program_holds_the_port(driver: Illuminator, line: PtyBoard):
    with pytest.raises(DeviceBusyError, match=line.path):
        open_illuminator(line.path)


def test_no_such_port():
    with pytest.raises(DeviceNotFoundError, match="plugged in"):
        open_illuminator("/dev/ttyHueflightNone")


@pytest.mark.parametrize("baud", [3_000_000, 1_000_000, 115_200])
def test_the_rate_of_the_line_is_found(line: PtyBoard, baud: int):
    line.baud = baud
    port = SerialPort(line.path)
    assert find_baud(port, timeout_s=1.0) == baud
    assert line.line_rate() == baud
    port.close()


def test_a_line_with_a_rate_that_is_not_tried_says_what_was(line: PtyBoard):
    line.baud = 38_400
    with pytest.raises(DeviceTimeoutError, match=r"3000000, 1000000, .* baud"):
        open_illuminator(line.path)
    found = open_illuminator(line.path, baud=38_400)  # as it is known to the user
    assert found.identity.place == line.path
    found.board.close()


@pytest.mark.parametrize("baud", [0, -9600])
def test_a_rate_that_cannot_be_is_refused(line: PtyBoard, baud: int):
    with pytest.raises(DeviceError, match=f"can't be set to {baud} baud"):
        open_illuminator(line.path, baud=baud)


def test_a_rate_that_the_adapter_refuses_is_told(line: PtyBoard, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object, **__: object) -> None:
        raise ValueError("Failed to set custom baud rate")

    monkeypatch.setattr(serial.Serial, "_set_special_baudrate", refuse)
    with pytest.raises(DeviceError, match="can't be set to 1234567 baud: Failed"):
        open_illuminator(line.path, baud=1_234_567)


def test_a_record_that_cannot_be_written_leaves_the_port_free(line: PtyBoard, tmp_path: Path):
    with pytest.raises(FileNotFoundError) as raised:
        open_illuminator(line.path, record=tmp_path / "absent" / "board.jsonl")
    open_illuminator(line.path).close()
    assert raised.traceback  # which keeps alive whatever was not closed


def test_the_record_of_a_board_that_is_refused_is_complete(line: PtyBoard, tmp_path: Path):
    register = line.board.registers.registers["board"]
    line.board.registers.set("board", value=register.reset ^ 1)
    record = tmp_path / "board.jsonl"
    with pytest.raises(WrongDeviceError) as raised:
        open_illuminator(line.path, record=record)
    with pytest.raises(WrongDeviceError):
        Illuminator(ReplayTransport(record))
    assert raised.traceback


def test_another_board(line: PtyBoard):
    register = line.board.registers.registers["board"]
    line.board.registers.set("board", value=register.reset ^ 1)
    with pytest.raises(WrongDeviceError):
        Illuminator(SerialTransport(port := SerialPort(line.path)), timeout_s=WAIT_S)
    port.close()
