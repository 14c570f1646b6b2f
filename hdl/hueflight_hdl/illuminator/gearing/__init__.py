# SPDX-License-Identifier: Apache-2.0
"""Gearing: converts between words of several ticks per clock and faster signals at the pins."""
