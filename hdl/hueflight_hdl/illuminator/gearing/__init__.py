"""Gearing: converts between words of several ticks per clock and faster signals at the pins."""
