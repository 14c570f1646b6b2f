"""Counts of any camera and images from earlier, read from files."""

from hueflight.importers.counts import read_counts
from hueflight.importers.images import read_image
from hueflight.importers.tcspc import tcspc_instrument

__all__ = ["read_counts", "read_image", "tcspc_instrument"]
