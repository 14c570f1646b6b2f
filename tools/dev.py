#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Set up, demonstrate, test and benchmark Hueflight with nothing but Python 3.11.

    python3 tools/dev.py demo            the simulated instrument, end to end, as a report
    python3 tools/dev.py test [--full]   lint, format, types, tests; --full adds the slow ones
    python3 tools/dev.py programs        tests with napari, Micro-Manager, Bluesky and readers
    python3 tools/dev.py bench NAME      a benchmark of tools/bench
    python3 tools/dev.py faults          runs of the daemon with faults at random
    python3 tools/dev.py packages        the source archive and wheels of a release
    python3 tools/dev.py run ARG...      any command inside the environment

Only the standard library is used here. The environment is made once in `.venv` and again
only when pyproject.toml, constraints.txt, a C source or the Python version changes.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
STAMP = VENV / ".hueflight-setup"
OLDEST_PYTHON = (3, 11)
PROGRAMS_VENV = ROOT / ".venv-programs"
FIRST_PICTURE, EVERYTHING = "report,export,daemon", "dev"  #: extras of pyproject.toml


def recipe_digest(extra: str) -> str:
    """Digest of everything the environment is made from."""
    digest = hashlib.sha256(f"{sys.version} {extra}".encode())
    for path in (ROOT / "pyproject.toml", ROOT / "constraints.txt", ROOT / "setup.py"):
        digest.update(path.read_bytes() if path.exists() else b"")
    for source in sorted((ROOT / "host").rglob("*.[ch]")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def set_up(extra: str) -> None:
    """Make `.venv` with the project installed in place, unless it is there and current.

    `extra` is what is needed: enough for what the README shows, or ``dev`` for all there is.
    """
    made_for = STAMP.read_text() if STAMP.exists() else ""
    if made_for in (recipe_digest(extra), recipe_digest(EVERYTHING)):
        return
    if made_for == recipe_digest(FIRST_PICTURE):
        print("Adding what the tests need to .venv (once; a minute or two) ...", flush=True)
    else:
        print("Setting up .venv (once; about a minute) ...", flush=True)
    if not (BIN / "python").exists():
        shutil.rmtree(VENV, ignore_errors=True)
        venv.create(VENV, with_pip=True)
    pip = [str(BIN / "python"), "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    constraints = ["-c", str(ROOT / "constraints.txt")]
    run([*pip, *constraints, "-e", f"{ROOT}[{extra}]"])
    STAMP.write_text(recipe_digest(extra))


def run(command: list[str], **environment: str) -> None:
    """Run a command in the project's root; a failure ends this program with its exit code."""
    finished = subprocess.run(command, cwd=ROOT, env=os.environ | environment)
    if finished.returncode:
        print(f"failed ({finished.returncode}): {' '.join(command)}", file=sys.stderr)
        raise SystemExit(finished.returncode)


def demo(arguments: list[str]) -> None:
    run([str(BIN / "hueflight"), "demo", *arguments])


def test(arguments: list[str]) -> None:
    """Lint, format, types, docstrings, tests. Further words go to pytest (a path, -k ...)."""
    full = "--full" in arguments or bool(os.environ.get("CI"))
    chosen = [word for word in arguments if word != "--full"]
    run([str(BIN / "ruff"), "check", "."])
    run([str(BIN / "ruff"), "format", "--check", "--quiet", "."])
    run([str(BIN / "basedpyright"), "--level", "error"])
    run([str(BIN / "python"), str(ROOT / "tools" / "check_docstrings.py")])
    workers = ["-n", str(os.cpu_count() or 1), "--dist", "loadfile", "--no-loadscope-reorder"]
    run([str(BIN / "pytest"), *workers, *(["--full", "--durations=30"] if full else []), *chosen])


def bench(arguments: list[str]) -> None:
    folder = ROOT / "tools" / "bench"
    scripts = {path.stem: path for path in folder.glob("[!_]*.py")}
    scripts |= {path.parent.name: path.parent for path in folder.glob("*/__main__.py")}
    if not arguments or arguments[0] not in scripts:
        raise SystemExit(f"which benchmark? one of: {', '.join(sorted(scripts))}")
    run([str(BIN / "python"), str(scripts[arguments[0]]), *arguments[1:]])


def packages(arguments: list[str]) -> None:
    run([str(BIN / "python"), str(ROOT / "tools" / "packages.py"), *arguments])


def programs(arguments: list[str]) -> None:
    """Tests with other programs, in an environment of their own: they bring a Qt and much else."""
    python = PROGRAMS_VENV / BIN.name / "python"
    if not python.exists():
        print("Setting up .venv-programs (once; a minute or two) ...", flush=True)
        venv.create(PROGRAMS_VENV, with_pip=True)
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    run([*pip, "-c", str(ROOT / "constraints-programs.txt"), "-e", f"{ROOT}[programs]"])
    checker = str(ROOT / "tools" / "check_docstrings.py")
    run([str(python), checker, str(ROOT / "host" / "hueflight" / "integrations")])
    tests = ["tests/host/integrations", "tests/host/export/test_independent_readers.py"]
    tests += ["tests/host/batch/test_object_store.py"]
    tests += ["-p", "no:cacheprovider", *arguments]
    run([str(python), "-m", "pytest", *tests], HUEFLIGHT_PROGRAMS="1", QT_QPA_PLATFORM="offscreen")


def run_inside(arguments: list[str]) -> None:
    if not arguments:
        raise SystemExit("run what? e.g. python3 tools/dev.py run hueflight --help")
    own = BIN / arguments[0]
    run([str(own) if own.exists() else arguments[0], *arguments[1:]])


def faults(arguments: list[str]) -> None:
    run([str(BIN / "python"), str(ROOT / "tools" / "fault_runs.py"), *arguments])


COMMANDS = {
    "demo": demo,
    "test": test,
    "programs": programs,
    "bench": bench,
    "faults": faults,
    "packages": packages,
    "run": run_inside,
}


def main() -> None:
    if sys.version_info < OLDEST_PYTHON:
        raise SystemExit(f"Python 3.11 or newer is needed; this is {sys.version.split()[0]}")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("command", choices=[*COMMANDS, "setup"])
    arguments, rest = parser.parse_known_args()
    if arguments.command != "programs":
        set_up(FIRST_PICTURE if arguments.command == "demo" else EVERYTHING)
    if arguments.command != "setup":
        COMMANDS[arguments.command](rest)


if __name__ == "__main__":
    main()
