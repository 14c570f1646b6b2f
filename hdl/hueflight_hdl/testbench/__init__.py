# SPDX-License-Identifier: Apache-2.0
"""Testbenches: compiled simulation through CXXRTL, and models of what surrounds a design."""
