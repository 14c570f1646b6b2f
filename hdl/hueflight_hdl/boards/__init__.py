"""Development boards: pins, clocks and gearing of each design."""
