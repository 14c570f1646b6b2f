"""Exposure timing, and the check that every readout is complete."""
