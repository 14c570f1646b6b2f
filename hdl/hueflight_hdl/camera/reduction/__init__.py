# SPDX-License-Identifier: Apache-2.0
"""Reduction of codes to sums: core, front, settings, packets."""
