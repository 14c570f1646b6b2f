# SPDX-License-Identifier: Apache-2.0
"""Small disks of a test's own: in memory, or in a file that can be unplugged and plugged in."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest


def require_mounts() -> None:
    """Skip the test where disks can't be mounted."""
    if os.geteuid() != 0 or shutil.which("mount") is None or shutil.which("mkfs.ext4") is None:
        pytest.skip("this user may not mount disks, or mkfs.ext4 is not installed")


class SmallDisk:
    """A disk that is mounted on a folder.

    Parameters
    ----------
    folder : Path
        Mount point, which is made.
    size_mb : int
        Size.
    image : Path, optional
        File that holds the disk; by default it is in memory.
    """

    def __init__(self, folder: Path, size_mb: int, image: Path | None = None) -> None:
        self.folder, self._image = folder, image
        self._size_mb = size_mb
        folder.mkdir(parents=True, exist_ok=True)
        if image is not None:
            with image.open("wb") as file:
                file.truncate(size_mb << 20)
            subprocess.run(["mkfs.ext4", "-q", "-m", "0", image], check=True)
        self.mount()

    def mount(self) -> None:
        """Plug the disk in."""
        options = ["-t", "tmpfs", "-o", f"size={self._size_mb}m", "none"]
        if self._image is not None:
            options = ["-o", "loop", str(self._image)]
        done = subprocess.run(["mount", *options, self.folder], capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"this user may not mount disks: {done.stderr.strip()}")

    def unmount(self) -> None:
        """Unplug the disk, whoever uses it."""
        subprocess.run(["umount", "-l", self.folder], check=False, capture_output=True)
