"""The NumPy backend: `scan` and `count` with the signatures of the compiled module."""

from hueflight.ingest.numpy_count import ADD, SATURATE, STORE, SUBTRACT, TILE, count
from hueflight.ingest.numpy_scan import MOST_FRAMES, STATE, scan

__all__ = ["ADD", "MOST_FRAMES", "SATURATE", "STATE", "STORE", "SUBTRACT", "TILE", "count", "scan"]
