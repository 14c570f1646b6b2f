# SPDX-License-Identifier: Apache-2.0
"""Parts that both boards use: counters, clock-domain crossings and the version of the gateware."""
