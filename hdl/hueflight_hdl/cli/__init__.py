# SPDX-License-Identifier: Apache-2.0
"""The command ``hueflight-hdl``: one module for each subcommand."""

from .app import main

__all__ = ["main"]
