# SPDX-License-Identifier: Apache-2.0
"""Tests of a camera on the bench, with bounds, through its driver alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from hueflight.devices.camera import Camera
from hueflight.devices.errors import DeviceError
from hueflight.devices.reduction import stop_reduction
from hueflight.devices.selftest import WORDS, SelfTestResult, Tell, line_test, temperature_test
from hueflight_protocol import Frame, PacketParser
from hueflight_protocol.packets import TestPattern
from hueflight_protocol.typed_registers import camera as registers
from hueflight_protocol.wire import PatternKind

PATTERNS = 16
"""Test packets that are sent."""
PATTERN_WORDS = 65_536
"""Words of four bytes in each: 256 KiB."""
FRAMES = 1000
_RATE_HZ = 1000.0
_QUIET_S = 0.2
"""Time without data after which nothing more is waited for."""
_PATIENCE_S = 2.0
"""Longest time for a test packet, and without data in a run."""


def run_camera_selftest(
    camera: Camera,
    /,
    *,
    words: int = WORDS,
    frames: int = FRAMES,
    tell: Tell = lambda result: None,
) -> tuple[SelfTestResult, ...]:
    """Test a camera: control line, temperature, packet link, and the frames of a run.

    The link carries known words from the camera's pattern generator. The run has the exposure, the
    frame rate and the sensor, real or synthetic, that the camera is set to; it sends codes.

    Parameters
    ----------
    camera : Camera
        The camera; no run may be on.
    words : int
        Words that are written and read again on the control line.
    frames : int
        Frames of the run.
    tell : callable
        Called with each result.

    Returns
    -------
    tuple of SelfTestResult
        Results, in the order of the tests.

    Raises
    ------
    DeviceError
        If a run is on, which another program may have begun, or the camera does not answer.
    """
    if camera.running():
        raise DeviceError(
            f"the camera at {camera.identity.place} is in a run, which a test would end: stop it "
            "first"
        )
    camera.listen(rate_hz=_RATE_HZ)
    _drain(camera, _QUIET_S)
    results = []
    for result in _tests(camera, words, frames):
        tell(result)
        results.append(result)
    return tuple(results)


def _tests(camera: Camera, words: int, frames: int) -> Iterator[SelfTestResult]:
    yield line_test(camera.board, words)
    if camera.board.read(registers.Features).temperature:
        yield temperature_test(camera.board)
    yield _link(camera)
    yield _frames(camera, frames)


def _drain(
    camera: Camera, quiet_s: float, keep: Callable[[bytes], object] = lambda piece: None
) -> None:
    """Read until nothing has come for some time; not for ever, from a camera that can't stop."""
    until = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until and (piece := camera.read(quiet_s)):
        keep(piece)


def _link(camera: Camera) -> SelfTestResult:
    """Test that known words arrive as they were sent."""
    parser = PacketParser()
    arrived = wrong = 0
    camera.board.write(registers.TestPacket(words=PATTERN_WORDS, pattern=PatternKind.XORSHIFT))
    for seed in range(1, PATTERNS + 1):
        camera.board.write(registers.TestSeed(seed))
        camera.board.write(registers.TestSend(1))
        patterns = _pattern(camera, parser)
        arrived += len(patterns)
        wrong += sum(pattern.errors() + int(pattern.words[0] != seed) for pattern in patterns)
    report = parser.report
    return SelfTestResult(
        "link",
        arrived == PATTERNS and not wrong and not report.damaged and not report.skipped_bytes,
        f"{arrived} of {PATTERNS} test packets arrived, {wrong} of {arrived * PATTERN_WORDS} words "
        f"wrong, {report.damaged} packets damaged, {report.skipped_bytes} other bytes",
        "all, none wrong",
    )


def _pattern(camera: Camera, parser: PacketParser) -> list[TestPattern]:
    """Read until a test packet has come."""
    until = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until:
        packets = parser.feed(camera.read(_QUIET_S))
        if found := [p.content for p in packets if isinstance(p.content, TestPattern)]:
            return found
    return []


def _frames(camera: Camera, frames: int) -> SelfTestResult:
    """Test that every frame of a run arrives, and that the camera dropped none."""
    if camera.can_reduce:
        stop_reduction(camera.board)
    pieces: list[bytes] = []  # parsed afterwards: a slow computer is not to stall the link
    camera.start(frame_limit=frames)
    came_last = began = time.monotonic()
    try:
        while camera.running() and time.monotonic() - came_last < _PATIENCE_S:
            if piece := camera.read(_QUIET_S):
                pieces.append(piece)
                came_last = time.monotonic()
        took_s = time.monotonic() - began
    finally:
        camera.stop()  # of no effect if the run has ended, as it should have
    _drain(camera, _QUIET_S, pieces.append)
    counters = camera.counters()
    parser = PacketParser()
    came = sum(isinstance(p.content, Frame) for piece in pieces for p in parser.feed(piece))
    came += sum(isinstance(p.content, Frame) for p in parser.finish())
    report, sent = parser.report, counters.frames_sent
    lost = counters.frames_dropped + counters.frames_aborted
    return SelfTestResult(
        "frames",
        came == sent == frames and not lost and not report.damaged and not report.skipped_bytes,
        f"{came} of {sent} frames arrived, {lost} not sent, {report.damaged} packets damaged; "
        f"{sum(map(len, pieces)) / took_s / 1e6:.1f} MB/s, {sent / took_s:.0f} frames/s, at most "
        f"{counters.buffer_peak} bytes waited for the link",
        f"{frames} arrive, all sent",
    )
