# SPDX-License-Identifier: Apache-2.0
"""Mutation testing; the command is ``tools/mutate.py``."""
