# SPDX-License-Identifier: Apache-2.0
"""The self-test of a camera on a model of one, over links that damage and lose what they carry."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator

import pytest

from hueflight.cli.app import main
from hueflight.devices import camera_selftest
from hueflight.devices.camera import Camera
from hueflight.devices.camera_selftest import run_camera_selftest
from hueflight.devices.errors import DeviceError
from hueflight.devices.selftest import SelfTestResult
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport
from hueflight.model.instrument import Instrument
from hueflight_protocol.typed_registers import camera as registers
from hueflight_protocol.wire import TEMPERATURE_UNKNOWN

FRAMES = 50
Change = Callable[[bytes], bytes]


class ChangedStream:
    """A link that changes what it carries, once it is told to."""

    def __init__(self, stream: SimulatedStream) -> None:
        self.stream = stream
        self.change: Change = lambda piece: piece

    def read(self, timeout_s: float, /) -> bytes:
        piece = self.stream.read(timeout_s)
        return self.change(piece) if piece else piece

    @property
    def statistics(self) -> StreamStatistics:
        return self.stream.statistics

    def close(self) -> None:
        self.stream.close()


class Bench:
    """A camera in software, and the link to it."""

    def __init__(self, instrument: Instrument, **options: int) -> None:
        bank = FrameBank.random(instrument.sensor, occupancy=0.3, frames=5)
        self.model = CameraModel(instrument.sensor, bank, **options)
        self.streams: list[ChangedStream] = []
        self.change: Change = lambda piece: piece
        self.camera = Camera(SimulatedTransport(self.model.handle), self._open)

    def _open(self, size: int) -> ChangedStream:
        self.streams.append(ChangedStream(SimulatedStream(self.model, size)))
        self.streams[-1].change = lambda piece: self.change(piece)
        return self.streams[-1]

    def results(self) -> dict[str, SelfTestResult]:
        found = run_camera_selftest(self.camera, words=5, frames=FRAMES)
        return {result.name: result for result in found}


@pytest.fixture
def bench(small: Callable[..., Instrument]) -> Bench:
    return Bench(small())


@pytest.fixture(autouse=True)
def short_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_selftest, "PATTERNS", 3)
    monkeypatch.setattr(camera_selftest, "PATTERN_WORDS", 500)


def test_a_good_camera_passes(bench: Bench) -> None:
    results = bench.results()
    assert list(results) == ["line", "link", "frames"]
    assert all(result.passed for result in results.values()), results
    assert results["link"].measured.startswith("3 of 3 test packets arrived, 0 of 1500 words")
    assert results["frames"].measured.startswith(f"{FRAMES} of {FRAMES} frames arrived, 0 not sent")
    assert not bench.camera.running()


def once(change: Change, *, after: int) -> Change:
    """Do something to one piece of the stream."""
    pieces: Iterator[int] = iter(range(1_000_000))
    return lambda piece: change(piece) if next(pieces) == after else piece


@pytest.mark.parametrize(
    ("change", "failing", "said"),
    [
        (
            once(lambda p: p[:70] + bytes([p[70] ^ 4]) + p[71:], after=1),
            "link",
            "1 packets damaged",
        ),
        (once(lambda p: b"", after=2), "link", "2 of 3 test packets arrived"),
        (once(lambda p: p + b"\0\0\0", after=0), "link", "3 other bytes"),
        (once(lambda p: p[: len(p) // 2], after=5), "frames", "0 not sent"),
    ],
    ids=["a bit", "a packet", "noise", "half a transfer"],
)
def test_what_the_link_does_to_packets_is_found(
    bench: Bench, change: Change, failing: str, said: str
) -> None:
    bench.change = change
    results = bench.results()
    assert [name for name, result in results.items() if not result.passed] == [failing]
    assert said in results[failing].measured


def test_frames_that_the_camera_drops_are_a_failure(small: Callable[..., Instrument]) -> None:
    bench = Bench(small(), buffer_bytes=200)  # room for a frame
    bench.camera.board.write(registers.Exposure(1))  # faster than anybody reads
    frames = bench.results()["frames"]
    assert not frames.passed
    assert " 0 not sent" not in frames.measured


def test_a_run_that_is_interrupted_is_ended(bench: Bench) -> None:
    def interrupt(piece: bytes) -> bytes:
        if bench.camera.running():
            raise KeyboardInterrupt
        return piece

    bench.change = interrupt
    with pytest.raises(KeyboardInterrupt):
        bench.results()
    assert not bench.camera.running()


def test_a_run_of_somebody_else_is_left_alone(bench: Bench) -> None:
    bench.camera.start()
    with pytest.raises(DeviceError, match="is in a run"):
        bench.results()
    assert bench.camera.running()


@pytest.mark.parametrize(
    ("mdeg", "passed", "said"),
    [(41_500, True, "41.5 °C"), (90_000, False, "90 °C"), (TEMPERATURE_UNKNOWN, False, "unknown")],
)
def test_the_temperature_is_told_and_bounded(
    bench: Bench, mdeg: int, passed: bool, said: str
) -> None:
    bench.model.registers.store(registers.Features(overlap=1, temperature=1))
    bench.model.registers.store(registers.Temperature(mdeg))
    temperature = bench.results()["temperature"]
    assert temperature.passed == passed
    assert temperature.measured.startswith(said)


def test_the_command_tests_a_camera_on_usb(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    serials = []

    def open_camera(serial: str) -> Camera:
        serials.append(serial)
        return bench.camera

    monkeypatch.setattr("hueflight.cli.board.open_usb_camera", open_camera)
    with pytest.raises(SystemExit) as ended:
        main(["board", "selftest", "usb:0001", "--words", "5", "--json"])
    assert (ended.value.code, serials) == (0, ["0001"])
    found = json.loads(capsys.readouterr().out)
    assert [test["name"] for test in found["tests"]] == ["line", "link", "frames"]
    with pytest.raises(SystemExit) as ended:
        main(["board", "skew", "usb:0001"])
    assert ended.value.code == 1
    assert "is a camera, which has no LEDs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("selftest usb:1 --loop", "usb:1: --loop belongs to illuminators"),
        ("selftest usb:1 --no-leds", "usb:1: --no-leds belongs to illuminators"),
        ("selftest usb:1 --dwell 0", "usb:1: --dwell 0.0 belongs to illuminators"),
        ("clock usb:1 --baud 115200", "usb:1: --baud 115200 belongs to illuminators"),
        ("clock usb:1 --words 5", "--words 5: belongs to `hueflight board selftest`"),
        ("clock usb:1 --dwell 2", "--dwell 2.0: belongs to `hueflight board selftest`"),
        ("selftest usb:1 --led 0", "--led 0: belongs to `hueflight board skew`"),
        ("selftest usb:1 --source internal", "--source internal: belongs to `hueflight board clo"),
    ],
)
def test_options_without_effect_are_refused(
    capsys: pytest.CaptureFixture[str], words: str, said: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["board", *words.split()])
    assert ended.value.code == 1
    assert said in " ".join(capsys.readouterr().err.split())
