# SPDX-License-Identifier: Apache-2.0
"""Python for 64-bit ARM, run by an emulator of that processor (qemu-user).

Debian's packages are unpacked into a folder of the test, without installing them, and the packages
from the index of Python are the wheels that are published for that processor.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from shutil import which

NEEDED = ("qemu-aarch64", "aarch64-linux-gnu-gcc", "apt-get", "dpkg")
MIRROR, RELEASE = "http://deb.debian.org/debian", "bookworm"
PYTHON = "3.11"  # that of the release
DEBIAN_PACKAGES = f"""python{PYTHON}-minimal libpython{PYTHON}-minimal libpython{PYTHON}-stdlib
    libc6 libgcc-s1 libstdc++6 zlib1g libexpat1 libffi8 libssl3 liblzma5 libbz2-1.0 libsqlite3-0
    libuuid1 libcrypt1""".split()
PLATFORMS = ("manylinux_2_28", "manylinux_2_27", "manylinux2014", "manylinux_2_17")


def missing() -> list[str]:
    """Programs that this needs and this machine lacks."""
    return [name for name in NEEDED if which(name) is None]


class Aarch64:
    """An interpreter with packages, in a folder."""

    def __init__(self, folder: Path) -> None:
        self._root, self._site = folder / "root", folder / "site"
        self._unpack(folder)

    def _unpack(self, folder: Path) -> None:
        """Fetch Debian's packages with settings, lists and caches of our own, and unpack them."""
        debs = folder / "debs"
        for part in ("lists/partial", "archives/partial"):
            (folder / part).mkdir(parents=True)
        debs.mkdir()
        sources = folder / "sources.list"
        sources.write_text(f"deb {MIRROR} {RELEASE} main\n")
        settings = {
            "APT::Architecture": "arm64",
            "APT::Architectures": "arm64",
            "APT::Sandbox::User": "",
            "Dir::State": folder,
            "Dir::State::status": "/dev/null",
            "Dir::Cache": folder,
            "Dir::Etc::sourcelist": sources,
            "Dir::Etc::sourceparts": "/dev/null",
        }
        apt = ["apt-get", "-qq", *(f"-o{name}={value}" for name, value in settings.items())]
        subprocess.run([*apt, "update"], check=True)
        subprocess.run([*apt, "download", *DEBIAN_PACKAGES], check=True, cwd=debs)
        for deb in sorted(debs.glob("*.deb")):
            subprocess.run(["dpkg", "--extract", deb, self._root], check=True)

    def install(self, *what: str, constraints: Path) -> None:
        """Install wheels for this processor from the index, or files."""
        python = [f"--platform={name}_aarch64" for name in PLATFORMS]
        python += ["--implementation=cp", f"--python-version={PYTHON}", "--abi=cp311", "--abi=abi3"]
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--target", str(self._site)]
        wheels = ["--only-binary=:all:", "-c", str(constraints), *what]
        subprocess.run([*pip, *python, *wheels], check=True)

    def python(self, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
        """Run Python with these arguments."""
        program = self._root / "usr/bin" / f"python{PYTHON}"
        return subprocess.run(
            ["qemu-aarch64", "-L", self._root, program, *words],
            cwd=cwd,
            env={"PYTHONPATH": str(self._site), "PATH": "/usr/bin", "HUEFLIGHT_KERNELS": "c"},
            capture_output=True,
            text=True,
            check=False,
        )
