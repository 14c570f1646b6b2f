"""Exposures, the seam to a sensor, and a synthetic sensor behind it."""
