# SPDX-License-Identifier: Apache-2.0
"""Formal verification of the gateware with open tools: yosys, SBY and yices."""
