# SPDX-License-Identifier: Apache-2.0
"""Development boards: pins, clocks and gearing of each design."""
