# SPDX-License-Identifier: Apache-2.0
"""A stream of packets under construction, and what a parser must make of it.

The expectations come from what was put in, never from running the parser over what came out.
"""

import hashlib
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hueflight_protocol as hp

LISTED_HITS = 64

Codes = NDArray[np.uint16]
Vector = tuple[str, bytes, dict[str, Any]]


def random_codes(seed: int, rows: int, cols: int, occupancy: float, *, code_bits: int = 9) -> Codes:
    """Return codes of which about `occupancy` are not 0, the same for the same seed."""
    # Philox's raw stream is fixed by its authors' specification, not by NumPy's version.
    raw = np.random.Philox(key=seed).random_raw(2 * rows * cols)
    lit = (raw[::2] >> np.uint64(11)) < np.uint64(int(occupancy * (1 << 53)))
    codes = 1 + raw[1::2] % np.uint64((1 << code_bits) - 1)
    return np.where(lit, codes, 0).astype(np.uint16).reshape(rows, cols)


def seal(packet: bytes) -> bytes:
    """Return a packet with its header check and its CRC made right again."""
    size = int.from_bytes(packet[6:8], "little")
    head = packet[: size - 4]
    if len(head) % 4 == 0:
        packet = head + hp.xor_words(head).to_bytes(4, "little") + packet[size:]
    return packet[:-4] + hp.crc32c(packet[:-4]).to_bytes(4, "little")


def patched(packet: bytes, at: int, new: bytes) -> bytes:
    """Return a packet with some bytes replaced; a negative `at` counts from the end."""
    at %= len(packet)
    return packet[:at] + new + packet[at + len(new) :]


def flipped(packet: bytes, at: int) -> bytes:
    """Return a packet with the lowest bit of one byte flipped, its checks left as they are."""
    at %= len(packet)
    return patched(packet, at, bytes([packet[at] ^ 1]))


@dataclass
class Stream:
    """A byte stream under construction, and what a parser must make of it."""

    about: str
    sequence: int = 0
    data: bytearray = field(default_factory=bytearray)
    packets: list[dict[str, Any]] = field(default_factory=list)
    damage: list[dict[str, Any]] = field(default_factory=list)
    report: dict[str, int] = field(
        default_factory=lambda: asdict(hp.ParserReport())  # all zero
    )

    def frame(self, codes: Codes, *, quiet: bool = False, **options: Any) -> bytes:
        """Add a frame; `quiet` leaves it out of the expectation. Returns its packet."""
        number = options.setdefault("frame", self.sequence)
        header: dict[str, Any] = {
            "sequence": self._next(),
            "timestamp": 1000 * number,
            "code_bits": 9,
            "run": 64,
            "periods": 3125,
            "flags": 0,
            "dropped": 0,
            "geometry": 0,
            "step": 0,
            "capture": 7,
            "clock_hz": 100_000_000,
            **options,
        }
        header["flags"] = hp.FrameFlags(header["flags"])
        packet = hp.encode_frame(codes, **header)
        header["flags"] = int(header["flags"])
        lit = np.flatnonzero(codes)
        content: dict[str, Any] = {
            "rows": codes.shape[0],
            "cols": codes.shape[1],
            **header,
            "hits": int(lit.size),
            "codes_sha256": hashlib.sha256(codes.astype("<u2").tobytes()).hexdigest(),
        }
        if lit.size <= LISTED_HITS:
            flat = codes.reshape(-1)
            content["pixels_and_codes"] = [[int(p), int(flat[p])] for p in lit]
        if header.get("abort_at") is not None:
            self.report["aborted"] += 1
            self.report["packets"] += 1
        elif not quiet:
            self._expect(packet, "frame", content)
            self.report["frames"] += 1
        self.data += packet
        return packet

    def event(self, **values: Any) -> None:
        """Add an event packet."""
        header = self._header()
        packet = hp.encode_event(hp.Event(header, **values))
        self._expect(
            packet, "event", asdict(header) | {"level": 0, "count": 1, "value": 0} | values
        )
        self.data += packet

    def status(self, **values: Any) -> None:
        """Add a status packet."""
        status = hp.Status(self._header(), **values)
        content = asdict(status)
        header = content.pop("header")
        packet = hp.encode_status(status)
        self._expect(packet, "status", header | content)
        self.data += packet

    def test(self, pattern: hp.PatternKind, seed: int, words: int, *, wrong: int = 0) -> None:
        """Add a test packet, of which the last `wrong` words have a bit flipped."""
        header = self._header()
        packet = hp.encode_test_pattern(header, pattern=pattern, seed=seed, words=words)
        if wrong:
            body_end = 32 + 4 + 4 * words
            for k in range(1, wrong + 1):
                packet = flipped(packet, body_end - 8 * k)
            packet = seal(packet)
        last = int.from_bytes(packet[32 + 4 * words : 36 + 4 * words], "little")
        content = {"pattern": int(pattern), "seed": seed, "words": words, "last_word": last}
        # A wrong word fails once against the word before it, and once as the next one's base.
        content["errors"] = 2 * wrong
        self._expect(packet, "test", asdict(header) | content)
        self.data += packet

    def sums(
        self,
        shape: tuple[int, int],
        first: int,
        pixels: int,
        widths: tuple[int, ...],
        **values: Any,
    ) -> None:
        """Add a packet of sums, which are random but for saturated ones in the last pixel."""
        header = self._header()
        raw = np.random.Philox(key=first + pixels).random_raw(pixels * len(widths))
        limits = np.array([(1 << width) - 1 for width in widths], np.uint64)
        sums = raw.reshape(pixels, -1) % limits
        sums[-1] = limits
        given: dict[str, Any] = {
            "widths": widths,
            "picture": 0,
            "first_pixel": first,
            "rows": shape[0],
            "cols": shape[1],
            "frames": 5,
            "missed": 0,
            "photons": 0,
            "tables": 0x1234_5678,
            "offsets": 0,
            "periods": 3125,
            "code_bits": 9,
            "flags": hp.FrameFlags.NONE,
            **values,
        }
        packet = hp.encode_sums(hp.Sums(header=header, values=sums.astype(np.uint32), **given))
        content = given | {
            "widths": list(widths),
            "flags": int(given["flags"]),
            "saturated": 1,
            "values": sums.tolist(),
        }
        self._expect(packet, "sums", asdict(header) | content)
        self.data += packet

    def opaque(self, kind: int, body: bytes, *, header_bytes: int = 32) -> None:
        """Add a packet of a type that version 1 does not interpret."""
        header = self._header()
        packet = hp.encode_packet(kind, body, header)
        extra = header_bytes - 32
        if extra:
            words = len(packet + bytes(extra)) // 4
            packet = packet[:28] + bytes(range(1, extra + 1)) + bytes(4) + packet[32:]
            packet = patched(packet, 6, header_bytes.to_bytes(2, "little"))
            packet = seal(patched(packet, -8, words.to_bytes(4, "little")))
        self._expect(packet, "opaque", asdict(header) | {"type": kind, "body": body.hex()})
        self.data += packet

    def bad(self, packet: bytes, *, rule: str | None, damaged: int = 1) -> None:
        """Add bytes that are no intact packet.

        `rule` is the one they break; empty if that is chance, None if nothing there is
        recognised as a packet.
        """
        if rule is not None:
            self.damage.append({"offset": len(self.data)} | ({"rule": rule} if rule else {}))
        self.report["damaged"] += damaged
        self.report["skipped_bytes"] += len(packet)
        self.data += packet

    def finished(self, name: str, **report: int) -> Vector:
        """Return the vector, with counts that do not follow from the packets alone."""
        expectation = {
            "about": self.about,
            "kind": "packets",
            "bytes": len(self.data),
            "packets": self.packets,
            "damage": self.damage,
            "report": self.report | report,
        }
        return name, bytes(self.data), expectation

    def _next(self) -> int:
        sequence, self.sequence = self.sequence, (self.sequence + 1) % (1 << 32)
        return sequence

    def _header(self) -> hp.PacketHeader:
        sequence = self._next()
        return hp.PacketHeader(sequence=sequence, timestamp=1000 * sequence, capture=7)

    def _expect(self, packet: bytes, kind: str, content: dict[str, Any]) -> None:
        place = {"offset": len(self.data), "size": len(packet), "kind": kind}
        self.packets.append(place | content)
        self.report["packets"] += 1
