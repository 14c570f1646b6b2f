"""Gateware of Hueflight: pulse generator, frame formatter, links, boards and builds."""
