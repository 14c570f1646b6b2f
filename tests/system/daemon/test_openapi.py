# SPDX-License-Identifier: Apache-2.0
"""Requests by the thousand, made from the daemon's own description of its API."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from support.daemon_process import Daemon, until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


def test_schemathesis_finds_nothing(start_daemon: Callable[[], Daemon], tmp_path: Path) -> None:
    pytest.importorskip("schemathesis", reason="schemathesis is not installed")
    config = tmp_path / "daemon.toml"
    text = config.read_text().replace("requests_per_s = 200", "requests_per_s = 100000")
    config.write_text(text.replace("burst = 400", "burst = 100000"))
    daemon = start_daemon()
    until(lambda: daemon.status()["picture"]["number"] > 0, "there is a picture")
    command = "from schemathesis.cli import schemathesis; schemathesis()"
    finished = subprocess.run(
        [
            sys.executable, "-c", command, "run", f"{daemon.url}/openapi.json",
            "--max-examples", "30", "--seed", "1", "--phases", "examples,coverage,fuzzing",
            "--checks", "not_a_server_error,status_code_conformance,content_type_conformance,"
            "response_schema_conformance,negative_data_rejection",
            "--request-timeout", "20",
        ],
        cwd=tmp_path, capture_output=True, text=True, timeout=400,
        env=os.environ | {"SCHEMATHESIS_HOOKS": ""},
    )  # fmt: skip
    assert finished.returncode == 0, finished.stdout[-6000:] + finished.stderr[-2000:]
    assert daemon.status()["state"] in ("running", "idle")
    recordings = tmp_path / "data/recordings"
    written = {path.parent for path in tmp_path.rglob("*.mcap*")}
    assert written <= {recordings} | {
        path for path in (tmp_path / "data/calibrations").glob("*") if path.is_dir()
    }
