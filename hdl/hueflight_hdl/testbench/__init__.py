"""Testbenches: compiled simulation through CXXRTL, and models of what surrounds a design."""
