# SPDX-License-Identifier: Apache-2.0
"""Exposure timing, and the check that every readout is complete."""
