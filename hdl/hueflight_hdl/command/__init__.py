"""The command `hueflight-hdl`: one module a subcommand, errors as sentences, never tracebacks."""

from .app import main

__all__ = ["main"]
