"""Formal verification of the gateware with open tools: yosys, SBY and yices."""
