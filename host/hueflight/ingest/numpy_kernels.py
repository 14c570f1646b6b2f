# SPDX-License-Identifier: Apache-2.0
"""The NumPy backend: `scan` and `count` with the signatures of the compiled module."""

from hueflight.backend.ingest import ADD, MOST_FRAMES, SATURATE, STORE, SUBTRACT, TILE
from hueflight.ingest.numpy_count import count
from hueflight.ingest.numpy_scan import STATE, scan

__all__ = ["ADD", "MOST_FRAMES", "SATURATE", "STATE", "STORE", "SUBTRACT", "TILE", "count", "scan"]
