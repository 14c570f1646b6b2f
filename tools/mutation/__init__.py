# SPDX-License-Identifier: Apache-2.0
"""Mutation testing of the gateware; the command is ``tools/mutate.py``."""
