# SPDX-License-Identifier: Apache-2.0
"""Compare compiled kernels, NumPy kernels and the reference parser on damaged streams.

    python3 tools/dev.py run python tools/fuzz/differential.py --seconds 60

Every input is given to both backends, whose results must be bit-identical: positions, tables,
totals and counts. Where CRCs detect all damage, the reference parser must find the same frames too.
The inputs are streams of random geometry, occupancy and run length with flipped bits, cuts,
insertions, repetitions, contradictory counts with corrected CRCs, and noise; with ``--corpus`` also
the inputs of tools/fuzz/corpus.zip. With ``--sanitize`` the C code is built by gcc with
AddressSanitizer and UndefinedBehaviorSanitizer.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import sysconfig
import time
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from hueflight.ingest import numpy_kernels
from hueflight.ingest.kernels import ADD, SATURATE, STATE, SUBTRACT, TILE, Scanned, choose
from hueflight_protocol import Frame, PacketParser, crc32c, encode_frame
from hueflight_protocol.wire import CHUNK_WORD, FRAME_HEADER, MAGIC

ROOT = Path(__file__).resolve().parent.parent.parent
INGEST = ROOT / "host" / "hueflight" / "ingest" / "_c"
BUILD = ROOT / "build" / "fuzz"
CORPUS = Path(__file__).with_name("corpus.zip")
REPORTED = ("packets", "frames", "aborted", "repeated", "damaged", "skipped_bytes", "missing")
REPORTED += ("restarts", "dropped", "dropped_before")
Geometry = tuple[int, int, int]


def build_sanitized() -> Path:
    """Compile the extension with sanitizers and return the library."""
    BUILD.mkdir(parents=True, exist_ok=True)
    library = BUILD / "_kernels.abi3.so"
    flags = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-shared"]
    include = f"-I{sysconfig.get_path('include')}"
    source = str(INGEST / "kernels.c")
    subprocess.run(["gcc", *flags, "-fPIC", include, source, "-o", str(library)], check=True)
    return library


def load(library: Path) -> Any:
    """Load the kernels from another file than the installed one."""
    spec = spec_from_file_location("hueflight.ingest._kernels", library)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def results(kernels: Any, data: bytes, geometry: Geometry, final: bool, limit: int) -> list[Any]:
    """Return everything that a backend returns for a stream, and at the end the counts."""
    rows, cols, code_bits = geometry
    state = np.zeros(len(STATE), np.int64)
    state[0] = 1
    chunks = np.zeros(4096, np.uint64)
    headers, places = np.zeros((limit, 64), np.uint8), np.zeros((limit, 2), np.uint64)
    others = np.zeros((3, 2), np.uint64)
    tables = [np.zeros((rows * cols, 1 << code_bits), kind) for kind in (np.uint16, np.uint32)]
    tables[0][:, 1:] = 65533  # nearly full
    returned: list[Any] = []
    position = 0
    while True:
        found = Scanned(
            *kernels.scan(
                data, position, final, rows, cols, code_bits, 0, limit, 0,
                state, chunks, headers, places, others,
            )
        )  # fmt: skip
        returned += [found, state.tolist(), others[: found.others].tolist()]
        if found.frames:
            count = -(-rows * cols // found.run)
            table = chunks[: count * found.stride].reshape(count, found.stride)
            returned += [table[:, : found.frames].tolist(), places[: found.frames].tolist()]
            chosen = np.arange(found.frames, dtype=np.uint32)
            for out, modes in ((tables[0], (ADD, SUBTRACT, SATURATE)), (tables[1], (ADD,))):
                done = np.zeros((count, -(-found.run // TILE)), np.uint8)
                for mode in modes:
                    if mode == SATURATE:
                        done[:] = 0
                    returned.append(
                        kernels.count(
                            data, chunks, found.stride, chosen, rows * cols, code_bits, found.run,
                            out, out.dtype == np.uint32, mode, done, 0, count,
                        )
                    )  # fmt: skip
                    returned.append(done.tolist())
        position = found.position
        if found.ended:
            return [*returned, tables[0].tobytes(), tables[1].tobytes()]


def last_state(returned: list[Any]) -> dict[str, int]:
    """Return the totals after the last call of `scan`."""
    at = max(i for i, item in enumerate(returned) if isinstance(item, Scanned))
    return dict(zip(STATE, returned[at + 1], strict=True))


def random_stream(rng: np.random.Generator) -> tuple[bytes, Geometry]:
    """Return a few frames of one geometry as packets."""
    rows, cols = rng.integers(1, 20, 2).tolist()
    code_bits = int(rng.integers(1, 11))
    packets = []
    gated, base = rng.random() < 0.3, int(rng.integers(1 << code_bits))
    for i in range(rng.integers(1, 6)):
        codes = rng.integers(0, 1 << code_bits, (rows, cols))
        if gated:
            codes = (base + codes % 24) % (1 << code_bits)
        codes[rng.random(codes.shape) >= rng.choice([0.0, 0.04, 0.1, 0.5, 0.95, 1.0])] = 0
        packets.append(
            encode_frame(
                codes,
                sequence=i,
                frame=i,
                timestamp=i,
                code_bits=code_bits,
                run=int(rng.choice([8, 8, 64, 72, 512])),
                dropped=i // 2,
                abort_at=0 if rng.random() < 0.1 else None,
            )
        )
    return b"".join(packets), (rows, cols, code_bits)


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a stream at random places."""
    octets = bytearray(data)
    for _ in range(rng.integers(0, 5)):
        at = int(rng.integers(len(octets) + 1))
        size = int(rng.integers(1, 40))
        change = rng.integers(6)
        if change == 0 and at < len(octets):
            octets[at] ^= 1 << int(rng.integers(8))
        elif change == 1:
            del octets[at : at + size]
        elif change == 2:
            octets[at:at] = rng.bytes(size)
        elif change == 3:
            octets[at:at] = octets[-size * 10 :]
        elif change == 4:
            octets[at:at] = MAGIC
        else:
            del octets[at:]
    return bytes(octets)


def contradict(data: bytes, rng: np.random.Generator) -> bytes:
    """Change words of intact packets and correct the check words and CRCs."""
    octets = bytearray(data)
    starts = [at for at in range(0, len(octets), 8) if octets[at : at + 4] == MAGIC]
    for start, stop in zip(starts, [*starts[1:], len(octets)], strict=True):
        kind = rng.integers(4)
        at = start + 4 * int(rng.integers(1, max(2, (stop - start) // 4)))
        word = int.from_bytes(octets[at : at + 4], "little")
        if kind == 0:
            word = int(rng.integers(1 << 32))
        elif kind == 1:
            hits = CHUNK_WORD["hits"]
            word ^= int(rng.integers(16)) << hits.shift
        elif kind == 2:
            at = start + FRAME_HEADER.offset("rows") + 4 * int(rng.integers(2))
            word = int(rng.choice([0, 1, 0xFFFF, 0x04000400, 0x00080008]))
        octets[at : at + 4] = word.to_bytes(4, "little")
        head = bytes(octets[start : start + 60])
        check = int(np.bitwise_xor.reduce(np.frombuffer(head, "<u4"))) if len(head) == 60 else 0
        octets[start + 60 : start + 64] = check.to_bytes(4, "little")
        octets[stop - 4 : stop] = crc32c(bytes(octets[start : stop - 4])).to_bytes(4, "little")
    return bytes(octets)


def compare(c: Any, data: bytes, geometry: Geometry, final: bool, limit: int) -> list[Any]:
    """Compare both backends on one input and exit if they differ."""
    compiled = results(c, data, geometry, final, limit)
    numpy = results(numpy_kernels, data, geometry, final, limit)
    if compiled != numpy:
        raise SystemExit(f"different results: {geometry=} {final=} {limit=} data={data.hex()}")
    return compiled


def compare_with_parser(returned: list[Any], data: bytes, geometry: Geometry) -> None:
    """Compare with the reference parser and exit if it finds other frames."""
    rows, cols, code_bits = geometry
    parser = PacketParser()
    packets = [*parser.feed(data), *parser.finish()]
    expected = np.zeros((rows * cols, 1 << code_bits), np.uint32)
    for packet in packets:
        content = packet.content
        if isinstance(content, Frame) and content.codes.shape == (rows, cols):
            expected[np.arange(rows * cols), content.codes.reshape(-1)] += 1
    state = last_state(returned)
    totals = {name: getattr(parser.report, name) for name in REPORTED}
    if {name: state[name] for name in REPORTED} != totals or returned[-1] != expected.tobytes():
        raise SystemExit(f"the reference parser differs: {geometry=} data={data.hex()}")


def replay(c: Any, corpus: Path) -> int:
    """Compare on all inputs of a corpus, whose first four bytes are options (see kernels.c)."""
    geometries = [(1, 1, 1), (3, 5, 9), (8, 8, 9), (1, 2, 13), (10, 13, 8), (5, 64, 7)]
    geometries += [(32, 32, 4), (256, 8, 2)]
    with ZipFile(corpus) as kept:
        inputs = [kept.read(name) for name in kept.namelist()]
    for data in inputs:
        if len(data) > 4:
            limit = 1 + data[2] % 7
            compare(c, data[4:], geometries[data[0] % 8], bool(data[1] & 1), limit)
    return len(inputs)


def fuzz(c: Any, seconds: float, seed: int) -> int:
    """Compare on random inputs for a number of seconds; return how many there were."""
    end = time.monotonic() + seconds
    tries = 0
    while time.monotonic() < end:
        rng = np.random.default_rng((seed, tries))
        data, geometry = random_stream(rng)
        final, limit = bool(rng.integers(2)), int(rng.integers(1, 8))
        kind = rng.integers(8)
        if kind == 0:
            data = rng.bytes(int(rng.integers(400)))
        elif kind <= 3:
            data = damage(contradict(data, rng), rng)
        else:
            data = damage(data, rng)
        returned = compare(c, data, geometry, final, limit)
        if kind > 3 and final:
            compare_with_parser(returned, data, geometry)
        tries += 1
    return tries


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60, help="duration of the run")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random inputs")
    parser.add_argument("--corpus", action="store_true", help="replay tools/fuzz/corpus.zip first")
    parser.add_argument("--sanitize", action="store_true", help="build with ASan and UBSan")
    parser.add_argument("--library", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.sanitize and arguments.library is None:
        library = build_sanitized()
        runtime = subprocess.run(
            ["gcc", "-print-file-name=libasan.so"], check=True, capture_output=True, text=True
        ).stdout.strip()
        environment = os.environ | {"LD_PRELOAD": runtime, "ASAN_OPTIONS": "detect_leaks=0"}
        command = [sys.executable, *sys.argv, "--library", str(library)]
        raise SystemExit(subprocess.run(command, env=environment).returncode)
    c = load(arguments.library) if arguments.library else choose("c")
    replayed = replay(c, CORPUS) if arguments.corpus else 0
    tries = fuzz(c, arguments.seconds, arguments.seed)
    print(f"{replayed} inputs of the corpus and {tries} random inputs: no difference")


if __name__ == "__main__":
    main()
