# SPDX-License-Identifier: Apache-2.0
"""The mutation tool: mutants are valid, differ from the original, and keep their names."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
TOOLS = ROOT / "tools"
SOURCE = '''\
class Part:
    """Not 1 == 2."""

    def __init__(self, width=8):
        self.width = width + 1

    def elaborate(self, platform):
        with m.If(a & ~b):
            m.d.sync += [x.eq(Mux(c == 3, d, e)), y.eq(x << 1)]
'''


@pytest.fixture
def operators(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    from mutation import operators

    return operators


def test_each_kind_of_change(operators, tmp_path: Path):
    path = tmp_path / "part.py"
    path.write_text(SOURCE)
    mutants = operators.mutants_of(tmp_path, path)
    found = {(mutant.operator, mutant.before, mutant.after) for mutant in mutants}
    assert found == {
        ("condition", "a & ~b", "~(a & ~b).bool()"),
        ("operator", "a & ~b", "((a) | (~b))"),
        ("invert", "~b", "(b)"),
        ("remove", "x.eq(Mux(c == 3, d, e)),", ""),
        ("remove", "y.eq(x << 1)", ""),
        ("choice", "Mux(c == 3, d, e)", "Mux(c == 3, e, d)"),
        ("compare", "c == 3", "((c) != (3))"),
        ("constant", "3", "4"),
        ("operator", "x << 1", "((x) >> (1))"),
        ("constant", "1", "0"),
    }
    for mutant in mutants:
        changed = mutant.apply(path.read_bytes())
        assert changed != path.read_bytes()
        ast.parse(changed)


def test_keys_outlive_changes_elsewhere(operators, tmp_path: Path):
    path = tmp_path / "part.py"
    path.write_text(SOURCE)
    before = {mutant.key for mutant in operators.mutants_of(tmp_path, path)}
    assert len(before) == 10
    path.write_text("# a comment\n" + SOURCE.replace("c == 3", "c == 4"))
    after = {mutant.key for mutant in operators.mutants_of(tmp_path, path)}
    assert len(before & after) == 6  # not those whose own text holds the 3


def test_the_sources_have_mutants_in_every_part():
    command = [sys.executable, TOOLS / "mutate.py", "list"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    counts = {line.split()[1]: int(line.split()[0]) for line in done.stdout.splitlines()}
    assert counts.pop("in") == sum(counts.values()) > 3000
    for part in ("illuminator/pulse_generator/limiter", "camera/formatter/hit_packer", "link/cobs"):
        assert counts[f"hdl/hueflight_hdl/{part}.py"] > 50
