"""Whole designs, from link to pins."""
