"""Simulation of gateware at millions of clocks a second, through CXXRTL."""
