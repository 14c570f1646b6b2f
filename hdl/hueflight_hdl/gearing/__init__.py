"""Gearing: several ticks in each clock, in and out of the pins, behind one seam."""
