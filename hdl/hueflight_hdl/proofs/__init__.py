"""Formal proofs of gateware, with the open tools: yosys, SBY, yices."""
