# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight`: one module a subcommand, errors as sentences, never tracebacks."""

from hueflight.cli.app import main

__all__ = ["main"]
