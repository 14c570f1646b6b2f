# SPDX-License-Identifier: Apache-2.0
"""Mutants of the host's software: valid changes of Python and C, and which of them do the same."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
TOOLS = ROOT / "tools"
PYTHON = '''\
LIMIT = 7


class Part:
    """Not 1 == 2."""

    def width(self, x: int = 3, *, y: bool = True) -> int:
        """Return 2 + 2."""
        if not x and 1 <= x < 9:
            self.add(f"{x + 1}")
        seen: list[int] = [i for i, _ in zip(y, y, strict=True) if i in x]
        while True:
            x += 2.5
            break
        return -x * 4
'''
C = """\
/* 1 + 1 */
#define TWICE(x) \\
    ((x) * 2)
enum { LIMIT = 8 };
static const int TABLE[2] = {1, 2};

static int sum(const int *from, int count)
{
    const char *text = "a + b"; // a + b
    if (!from || (count & 0x10u) >= 3)
        return -1;
    float whole = (float)*from * .5f + 0.0f;
    return count << 1 ? from[0] : TWICE(count);
}
"""


@pytest.fixture
def tools(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(TOOLS))


def test_each_kind_of_change_of_python(tools, tmp_path: Path):
    from mutation.python_operators import python_mutants

    path = tmp_path / "part.py"
    path.write_text(PYTHON)
    mutants = python_mutants(tmp_path, path)
    found = {(mutant.operator, mutant.before, mutant.after) for mutant in mutants}
    assert found == {
        ("condition", "not x and 1 <= x < 9", "(not (not x and 1 <= x < 9))"),
        ("logic", "not x and 1 <= x < 9", "((not x) or (1 <= x < 9))"),
        ("invert", "not x", "(x)"),
        ("compare", "1 <= x < 9", "((1) < (x) < (9))"),
        ("compare", "1 <= x < 9", "((1) <= (x) <= (9))"),
        ("constant", "1", "0"),
        ("constant", "9", "10"),
        ("remove", 'self.add(f"{x + 1}")', "pass"),
        ("condition", "i in x", "(not (i in x))"),
        ("compare", "i in x", "((i) not in (x))"),
        ("condition", "True", "(not (True))"),
        ("constant", "True", "False"),
        ("operator", "x += 2.5", "x -= (2.5)"),
        ("constant", "2.5", "5.0"),
        ("loop", "break", "continue"),
        ("operator", "-x * 4", "((-x) / (4))"),
        ("invert", "-x", "(x)"),
        ("constant", "4", "5"),
    }
    assert {mutant.where for mutant in mutants} == {"Part.width"}
    assert len({mutant.key for mutant in mutants}) == len(mutants)
    for mutant in mutants:
        ast.parse(mutant.apply(path.read_bytes()))


def test_each_kind_of_change_of_c(tools, tmp_path: Path):
    from mutation.c_operators import c_mutants

    path = tmp_path / "sum.c"
    path.write_text(C)
    mutants = c_mutants(tmp_path, path)
    found = {(mutant.operator, mutant.before, mutant.after) for mutant in mutants}
    assert found == {
        (
            "condition",
            "(!from || (count & 0x10u) >= 3)",
            "(!(!from || (count & 0x10u) >= 3))",
        ),
        ("invert", "!", ""),
        ("logic", "||", "&&"),
        ("operator", "&", "|"),
        ("constant", "0x10u", "17u"),
        ("compare", ">=", ">"),
        ("constant", "3", "4"),
        ("constant", "1", "0"),
        ("operator", "*", "/"),
        ("constant", ".5f", "1.0f"),
        ("operator", "+", "-"),
        ("constant", "0.0f", "1.0f"),
        ("operator", "<<", ">>"),
        ("constant", "0", "1"),
    }
    assert {mutant.where for mutant in mutants} == {"sum"}
    assert [mutant.line for mutant in mutants] == sorted(mutant.line for mutant in mutants)
    for mutant in mutants:
        changed = tmp_path / "changed.c"
        changed.write_bytes(mutant.apply(path.read_bytes()))
        subprocess.run(["cc", "-fsyntax-only", changed], check=True)


def test_code_that_does_the_same_is_recognized(tools):
    from mutation.python_operators import same_code

    original = b"def f(x):\n    return x + 1\n"
    assert same_code(original, b"def f(x):\n    # more\n\n    return (x) + (1)\n")
    for other in (b"x - 1", b"x + 2", b"x + True", b"y + 1", b"x + 1.0"):
        assert not same_code(original, original.replace(b"x + 1", other)), other


def test_kernels_of_a_changed_source_are_used(tools, tmp_path: Path):
    from mutation.kernels import Kernels

    shutil.copytree(ROOT / "host", tmp_path / "tree" / "host")
    kernels = Kernels(tmp_path / "tree", tmp_path / "kept")
    folder = tmp_path / "tree" / "host" / "hueflight" / "reconstruction" / "sums"
    source, module = folder / "_c" / "kernels.c", folder / "_kernels.abi3.so"
    original = source.read_bytes()
    kernels.extensions = [each for each in kernels.extensions if ".sums." in each.name]
    kernels.compile_all()
    before = module.read_bytes()
    assert b"phases - 1" in original
    for edited, status in (
        (original.replace(b"phases - 1", b"phases - 2"), ""),
        (original + b"/* */", "same code"),
        (original + b"}", "not compiled"),
    ):
        source.write_bytes(edited)
        with kernels.changed(source) as found:
            assert found == status
            assert (module.read_bytes() == before) == bool(status)
        assert module.read_bytes() == before


def test_the_sources_have_mutants_in_every_part():
    command = [sys.executable, TOOLS / "mutate.py", "list", "--of", "host"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    counts = {line.split()[1]: int(line.split()[0]) for line in done.stdout.splitlines()}
    assert counts.pop("in") == sum(counts.values()) > 10_000
    for path in (
        "protocol/hueflight_protocol/parser.py",
        "host/hueflight/ingest/_c/scan.h",
        "host/hueflight/ingest/stream.py",
        "host/hueflight/recording/writer.py",
        "host/hueflight/fit/_c/scoring.h",
        "host/hueflight/reconstruction/joint.py",
        "host/hueflight/reconstruction/pooled/_c/kernels.c",
    ):
        assert counts[path] > 50, path
    assert "protocol/hueflight_protocol/typed_registers/camera.py" not in counts


def test_warm_runs_of_tests(tools, tmp_path: Path):
    """Each run loads the sources anew; one that fails, dies or goes on too long has not passed."""
    from mutation.warm import WarmTests

    folders = (tmp_path, ROOT / "host", ROOT / "protocol")
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, folders)),
        "PYTHONDONTWRITEBYTECODE": "1",  # sources of the same size, changed within a second
    }
    (tmp_path / "test_it.py").write_text("import part\ndef test_it():\n    part.work()\n")
    warm = WarmTests(tmp_path, environment, [])
    try:
        for body, limits, expected in (
            ("pass", (None, None), True),
            ("assert False", (None, None), False),
            ("import os; os.abort()", (None, None), False),
            ("while True: pass", (5, None), False),
            ("import time; time.sleep(900)", (None, 5), False),
            ("pass", (None, None), True),
        ):
            (tmp_path / "part.py").write_text(f"def work():\n    {body}\n")
            options = ["-q", "-p", "no:cacheprovider", "test_it.py"]
            passed, seconds = warm.run(options, limit=limits[0], timeout=limits[1])
            assert passed == expected, body
            assert seconds > 0
    finally:
        warm.close()
