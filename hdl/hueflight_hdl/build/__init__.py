# SPDX-License-Identifier: Apache-2.0
"""Bitstreams: synthesis, placement and routing, timing reports and vendor projects."""
