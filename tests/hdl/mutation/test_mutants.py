# SPDX-License-Identifier: Apache-2.0
"""The mutation tool: mutants are valid, differ from the original, and keep their names."""

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


@pytest.mark.slow
def test_only_changes_of_the_hardware_change_the_netlists(tmp_path: Path):
    folders = [tmp_path / name for name in ("hdl", "protocol")]
    for folder in folders:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder.name, folder, ignore=ignored)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    path = tmp_path / "hdl" / "hueflight_hdl" / "illuminator" / "arming.py"

    def netlists() -> str:
        command = [sys.executable, TOOLS / "mutation" / "netlist.py"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stdout

    original = netlists()
    text = path.read_text()
    path.write_text(text + "UNUSED = 1\n")
    assert netlists() == original
    assert text.count("start.eq(1)") == 1
    path.write_text(text.replace("start.eq(1)", "start.eq(0)"))
    assert netlists() != original


def test_the_interval_of_a_score(operators):
    """Against the rule of three, and against values tabulated by Clopper and Pearson (1934)."""
    from mutation.page import interval

    low, high = interval(300, 0)
    assert low == pytest.approx(1 - 3.69 / 300, abs=1e-3)  # -ln(0.025) = 3.69
    assert high == 1.0
    # 8 of 10: 44.4 to 97.5 %, as in the tables of the exact interval
    assert interval(8, 2) == pytest.approx((0.4439, 0.9748), abs=1e-4)
    assert interval(0, 5)[0] == 0.0


def test_a_sample_stays_when_other_sources_change(monkeypatch, tmp_path: Path):
    """Mutants that are still there keep their order, so that a sample can go on."""
    monkeypatch.syspath_prepend(str(TOOLS))
    import mutate

    monkeypatch.setattr(mutate, "ROOT", tmp_path)
    one, two = tmp_path / "one.py", tmp_path / "two.py"
    one.write_text(SOURCE)
    two.write_text(SOURCE.replace("Part", "Other"))
    suites = [mutate.Suite("both", (one, two), ())]
    before = [mutant.key for _, mutant in mutate.sample(mutate.GATEWARE, suites, seed=1)]
    two.write_text(SOURCE.replace("Part", "Other").replace("c == 3", "c == 5"))
    after = [mutant.key for _, mutant in mutate.sample(mutate.GATEWARE, suites, seed=1)]
    gone = set(before) - set(after)
    assert 0 < len(gone) < len(before) / 2
    assert [key for key in before if key not in gone] == [key for key in after if key in before]
    assert [mutant.key for _, mutant in mutate.sample(mutate.GATEWARE, suites, seed=2)] != after
