# SPDX-License-Identifier: Apache-2.0
"""Written projects stand alone: no constraint is ignored, and missed timing is an error."""

import subprocess

import pytest

from hueflight_hdl.build.project import write_project
from hueflight_hdl.toolchain import tool_environment


@pytest.mark.parametrize(("mhz", "code"), [(12, 0), (900, 1)])
def test_a_project_builds_and_fails_with_its_timing(builder, small, tmp_path, mhz, code):
    files = {path.name for path in write_project(small(mhz), tmp_path)}
    assert {"top.v", "top.pcf", "check_timing.py", "build_top.sh"} <= files
    done = subprocess.run(
        ["sh", "build_top.sh"],
        cwd=tmp_path,
        env=tool_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    assert ("TIMING IS NOT MET" in done.stdout) == bool(code)
    assert (tmp_path / "top.bin").exists() != bool(code)
    log = (tmp_path / "top.tim").read_text()
    assert "ignoring" not in log.lower()
    assert "constraint" in log or "PASS" in log or "FAIL" in log
