# SPDX-License-Identifier: Apache-2.0
"""Runs of the daemon's own process with faults at random, whose books must be right in the end."""
