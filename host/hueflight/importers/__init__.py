# SPDX-License-Identifier: Apache-2.0
"""Readers of counts from files of any camera, and of reconstructed images."""

from hueflight.importers.captures import Capture, read_capture, write_counts
from hueflight.importers.counts import read_counts
from hueflight.importers.images import read_image
from hueflight.importers.options import ReadOptions
from hueflight.importers.readers import READERS
from hueflight.importers.tcspc import tcspc_instrument

__all__ = [
    "READERS",
    "Capture",
    "ReadOptions",
    "read_capture",
    "read_counts",
    "read_image",
    "tcspc_instrument",
    "write_counts",
]
