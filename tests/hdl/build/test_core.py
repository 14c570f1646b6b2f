# SPDX-License-Identifier: Apache-2.0
"""The illuminator without a board: its ports, and its own testbench in other simulators."""

import re
import shutil
import subprocess

import pytest

from hueflight_hdl.cli import main
from hueflight_hdl.toolchain import find_tool


@pytest.fixture
def core(simulator, tmp_path):
    sizes = ("channels=3", "pulses=1", "steps=1")
    words = [word for size in sizes for word in ("--set", size)]
    with pytest.raises(SystemExit) as ended:
        main(["verilog", "illuminator", "--core", "--folder", str(tmp_path), *words])
    assert not ended.value.code
    return tmp_path


def test_it_needs_no_primitive_and_states_its_ports(core):
    text = (core / "hueflight_illuminator.v").read_text()
    modules = set(re.findall(r"^module (\S+?) ?\(", text, re.M))
    instances = set(re.findall(r"^  (\\\S+|[A-Z]\w*) +\S+ +\($", text, re.M))
    assert instances
    assert instances <= modules
    ports = dict(
        re.findall(r"^\| (\w+) \| (input|output) \|", (core / "ports.md").read_text(), re.M)
    )
    top = text[: text.index("endmodule")]
    found = {
        name: way for way, name in re.findall(r"^  (input|output) (?:\[.*\] )?(\w+);", top, re.M)
    }
    assert ports == found


def verdicts(core, command: list[str]) -> list[bool]:
    """Run the compiled testbench, then with a false expectation."""
    passed = []
    for change in (None, 40):
        if change is not None:
            words = (core / "expected.hex").read_text().split()
            words[change] = "f" * len(words[change])
            (core / "expected.hex").write_text("\n".join(words))
        done = subprocess.run(command, cwd=core, capture_output=True, text=True, check=True)
        passed.append("PASS" in done.stdout)
        assert ("FAIL" in done.stdout) != passed[-1]
    return passed


@pytest.mark.slow
def test_its_testbench_in_verilator(core, verilator):
    tool = find_tool("verilator")
    options = ["--binary", "--timing", "-Wno-fatal", "--top-module", "testbench"]
    command = [tool, *options, "-CFLAGS", "-O0", "hueflight_illuminator.v", "testbench.v"]
    subprocess.run(command, cwd=core, capture_output=True, check=True)
    assert verdicts(core, ["obj_dir/Vtestbench"]) == [True, False]


@pytest.mark.slow
def test_its_testbench_in_icarus(core):
    if shutil.which("iverilog") is None:
        pytest.skip("Icarus Verilog is not installed")
    command = ["iverilog", "-g2005", "-o", "test", "hueflight_illuminator.v", "testbench.v"]
    subprocess.run(command, cwd=core, capture_output=True, check=True)
    assert verdicts(core, ["vvp", "test"]) == [True, False]
