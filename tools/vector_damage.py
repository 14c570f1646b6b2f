# SPDX-License-Identifier: Apache-2.0
"""Golden vectors of the stream from camera to host that are damaged, or lie."""

from collections.abc import Callable, Iterator

import numpy as np

import hueflight_protocol as hp
from vector_stream import Codes, Stream, Vector, flipped, patched, random_codes, seal


def middle_codes() -> Codes:
    """Return 3 x 32 codes that make a bitmap chunk of 64 pixels and a dense one of 32."""
    return np.concatenate([random_codes(21, 2, 32, 0.4), random_codes(22, 1, 32, 1.0)])


def around(name: str, about: str, bad: Callable[[bytes], bytes], rule: str | None) -> Vector:
    """Return a stream whose middle packet `bad` has damaged."""
    stream = Stream(about)
    stream.frame(random_codes(20, 4, 32, 0.4))
    scratch = Stream("", sequence=stream.sequence)
    packet = scratch.frame(middle_codes())
    stream.bad(bad(packet), rule=rule, damaged=int(rule is not None))
    stream.sequence += 1
    stream.frame(random_codes(23, 4, 32, 0.4))
    return stream.finished(name, missing=1)


def damages() -> Iterator[Vector]:
    """Yield streams that were damaged on the way."""
    for name, at, rule in (
        ("magic", 1, None),
        ("version", 4, ""),
        ("type", 5, ""),
        ("header", 40, "P5"),
        ("header-check", 60, "P5"),
        ("chunk-word", 65, ""),
        ("bitmap", 70, ""),
        ("codes", 80, ""),
        ("end-word", -16, ""),
        ("crc", -4, "P6"),
    ):
        about = f"One bit flipped ({name})."
        yield around(f"damaged-{name}", about, lambda p, at=at: flipped(p, at), rule)
    yield around("damaged-cut", "The middle packet lost its end.", lambda p: p[:101], "")
    yield around(
        "damaged-hole",
        "Three bytes lost: all that follows is out of alignment.",
        lambda p: p[:80] + p[83:],
        "",
    )
    yield around(
        "damaged-splice", "Header of one frame, body of another, both intact.", splice, "P6"
    )

    for name, at in (("body", 34), ("trailer", -8), ("crc", -1)):
        stream = Stream(f"One bit flipped in an event ({name}).")
        stream.event(code=1)
        event = hp.encode_event(hp.Event(hp.PacketHeader(sequence=1), 3))
        stream.bad(flipped(event, at), rule="" if name == "trailer" else "P6")
        stream.sequence = 2
        stream.event(code=2)
        yield stream.finished(f"damaged-event-{name}", missing=1)
    stream = Stream("A magic and one byte more, right before a packet.")
    stream.frame(random_codes(24, 4, 32, 0.4))
    stream.bad(hp.MAGIC + b"\1", rule="")
    stream.frame(random_codes(25, 4, 32, 0.4))
    yield stream.finished("damaged-stub")

    whole = Stream("").frame(random_codes(24, 4, 32, 0.4))
    stream = Stream("The stream ends within a packet.")
    stream.frame(random_codes(25, 4, 32, 0.4))
    stream.bad(whole[:100], rule="P7")
    yield stream.finished("damaged-end")
    stream = Stream("Noise before, zeros between, a lone magic after.")
    stream.bad(random_codes(26, 1, 30, 1.0, code_bits=16).tobytes()[:53], rule=None, damaged=0)
    stream.frame(random_codes(27, 4, 32, 0.4))
    stream.bad(bytes(61), rule=None, damaged=0)
    stream.frame(random_codes(28, 4, 32, 0.4))
    stream.bad(hp.MAGIC + bytes(12), rule="P3")
    stream.frame(random_codes(29, 4, 32, 0.4))
    yield stream.finished("damaged-noise")


def splice(packet: bytes) -> bytes:
    """Return the packet with another frame's header, which is intact by itself."""
    other = Stream("", sequence=99).frame(np.zeros((3, 32), np.uint16), timestamp=1)
    return other[:64] + packet[64:]


def u16(number: int) -> bytes:
    return number.to_bytes(2, "little")


def u32(number: int) -> bytes:
    return number.to_bytes(4, "little")


def lying_frames() -> Iterator[Vector]:
    """Yield frames whose checks are right and whose contents are not."""
    # The middle packet of `around`: 3 x 32 pixels in runs of 64. A bitmap chunk stands at byte
    # 64; the second run has 32 pixels, all lit, and is dense.
    scratch = Stream("").frame(middle_codes())
    first = int.from_bytes(scratch[64:68], "little")
    hits = first >> 16
    size = -(-(8 + -(-hits * 9 // 8)) // 4) * 4
    second = 68 + size
    word = int.from_bytes(scratch[second : second + 4], "little")
    trailer = len(scratch) - 16
    total = hits + 32

    cases: list[tuple[str, str, str, int, bytes]] = [
        ("length", "F1", "A frame that states a length.", 8, u32(4096)),
        ("rows-zero", "F2", "No rows.", 40, u16(0)),
        ("rows-1025", "F2", "Too many rows.", 40, u16(1025)),
        ("cols-zero", "F2", "No columns.", 42, u16(0)),
        ("width-zero", "F2", "Codes of no bits.", 46, b"\0"),
        ("width-17", "F2", "Codes of 17 bits.", 46, b"\x11"),
        ("run-zero", "F3", "Runs of no pixels.", 44, u16(0)),
        ("run-12", "F3", "A run length that is no multiple of 8.", 44, u16(12)),
        ("run-4104", "F3", "A run length beyond the largest.", 44, u16(4104)),
        ("run-short", "F3", "1024 x 1024 in runs of 56: too many chunks.", 40,
         u16(1024) + u16(1024) + u16(56)),
        ("flags", "F4", "A flag without a meaning.", 48, u16(1 << 7)),
        ("version", "P3", "A version that does not exist yet.", 4, b"\x02"),
        ("header-size", "P4", "A frame header of 72 bytes.", 6, u16(72)),
        ("hits-zero", "F8", "A chunk without hits.", 64, u32(first & 0xFFFF)),
        ("hits-many", "F8", "More hits than pixels.", 64, u32(first & 0xFFFF | 65 << 16)),
        ("kind-bitmap", "F9", "A bitmap where dense is shorter.", second, u32(word ^ 3)),
        ("kind-dense", "F9", "Dense where a bitmap is shorter.", 64, u32(first ^ 3)),
        ("kind-zero", "F6", "Kind 0 with an index.", second, u32(word & ~3)),
        ("index-same", "F7", "The same index twice.", second, u32(word & ~0xFFFC)),
        ("index-high", "F7", "An index beyond the frame.", second, u32(word & ~0xFFFC | 2 << 2)),
        ("status", "F12", "A status bit without a meaning.", trailer, u32(3 | 2 << 2 | 2 << 16)),
        ("chunks", "F12", "The trailer counts three chunks of two.", trailer, u32(3 | 3 << 16)),
        ("total", "F12", "The trailer's hits are not the chunks'.", trailer + 4, u32(total - 1)),
        ("words", "P7", "The trailer's length is not the packet's.", trailer + 8,
         u32(len(scratch) // 4 - 2)),
    ]  # fmt: skip
    for name, rule, about, at, new in cases:
        yield around(
            f"lie-{name}", about, lambda p, at=at, new=new: seal(patched(p, at, new)), rule
        )
    spare = next(at for at in range(68, 76) if scratch[at] != 0xFF)
    lit = scratch[spare] | scratch[spare] + 1
    about = "One bit more in the bitmap than hits."
    yield around("lie-bitmap-hits", about, lambda p: seal(patched(p, spare, bytes([lit]))), "F11")
    fewer = u32(word - (1 << 16))
    about = "A dense chunk says 31 hits and has 32."
    yield around(
        "lie-dense-hits",
        about,
        lambda p: seal(patched(patched(p, second, fewer), trailer + 4, u32(total - 1))),
        "F11",
    )


def lying_payloads() -> Iterator[Vector]:
    """Yield frames whose payloads are not what their chunk words say."""

    def small(name: str, rule: str, about: str, change: Callable[[bytes], bytes]) -> Vector:
        stream = Stream(about)
        codes = np.zeros((1, 13), np.uint16)
        codes[0, [2, 5]] = 300, 7
        stream.frame(codes, run=16)
        scratch = Stream("", sequence=1)
        packet = scratch.frame(codes, run=16)
        # One chunk: word at 64, bitmap 68 and 69, codes 70 to 72, padding 73 to 75, pad word 76.
        stream.bad(seal(change(packet)), rule=rule)
        stream.sequence = 2
        stream.frame(codes, run=16)
        return stream.finished(f"lie-{name}", missing=1)

    yield small(
        "bitmap-beyond",
        "F10",
        "A bitmap bit for a pixel that does not exist.",
        lambda p: patched(p, 68, bytes([p[68] & ~4, p[69] | 0x20])),
    )
    yield small(
        "bits-beyond",
        "F10",
        "A bit set behind the last code.",
        lambda p: patched(p, 72, bytes([p[72] | 0x80])),
    )
    yield small("padding", "F10", "A padding byte that is not 0.", lambda p: patched(p, 74, b"\1"))
    yield small(
        "code-zero",
        "F11",
        "A hit whose code is 0.",
        lambda p: patched(p, 70, bytes([p[70] & 0, p[71] & ~1])),
    )
    yield small("pad-word", "F6", "A pad word that is not 0.", lambda p: patched(p, 76, u32(4)))
    yield small(
        "pad-missing", "F6", "No pad word where one is due.", lambda p: resized(p[:76] + p[80:])
    )
    yield small(
        "pad-thrice", "F6", "Three pad words.", lambda p: resized(p[:76] + bytes(8) + p[76:])
    )

    stream = Stream("A pad word where none is due.")
    dark = np.zeros((1, 13), np.uint16)
    stream.frame(dark, run=16)
    packet = Stream("", sequence=1).frame(dark, run=16)
    stream.bad(seal(resized(packet[:64] + bytes(4) + packet[64:])), rule="F6")
    stream.sequence = 2
    stream.frame(dark, run=16)
    yield stream.finished("lie-pad-undue", missing=1)


def resized(packet: bytes) -> bytes:
    """Return a packet whose trailer says the length that it has now."""
    return patched(packet, -8, u32(len(packet) // 4))


def lying_packets() -> Iterator[Vector]:
    """Yield packets other than frames that break their rules."""
    header = hp.PacketHeader(sequence=1)
    event = hp.encode_event(hp.Event(header, 3))
    test = hp.encode_test_pattern(header, pattern=hp.PatternKind.COUNTER, seed=1, words=4)
    opaque = hp.encode_packet(200, b"later", header)
    cases: list[tuple[str, str, str, bytes]] = [
        ("event-level", "E2", "An event level that does not exist.", patched(event, 34, b"\3")),
        ("event-reserved", "E2", "A reserved byte that is not 0.", patched(event, 35, b"\1")),
        ("event-size", "E1", "An event body of eight bytes.",
         hp.encode_packet(hp.PacketType.EVENT, bytes(8), header)),
        ("status-size", "E1", "A status body of one byte.",
         hp.encode_packet(hp.PacketType.STATUS, b"\0", header)),
        ("test-pattern", "E4", "A test pattern that does not exist.", patched(test, 32, b"\2")),
        ("test-size", "E1", "A test body without a seed.",
         hp.encode_packet(hp.PacketType.TEST, bytes(4), header)),
        ("body-padding", "P8", "Body padding that is not 0.", patched(opaque, 38, b"\1")),
        ("body-length", "P8", "A body longer than the largest.",
         patched(opaque, 8, u32(1 + (1 << 20)))),
        ("body-words", "P7", "The trailer's length is not the packet's.",
         patched(opaque, -8, u32(4))),
        ("opaque-header", "P4", "An unknown type with a header of 36 bytes.",
         patched(opaque, 6, u16(36))),
    ]  # fmt: skip
    for name, rule, about, packet in cases:
        stream = Stream(about)
        stream.event(code=1)
        stream.bad(seal(packet), rule=rule)
        stream.sequence = 2
        stream.event(code=2)
        yield stream.finished(f"lie-{name}", missing=1)


def damage_vectors() -> Iterator[Vector]:
    """Yield all damaged vectors of the stream from camera to host."""
    yield from damages()
    yield from lying_frames()
    yield from lying_payloads()
    yield from lying_packets()
