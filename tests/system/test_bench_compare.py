# SPDX-License-Identifier: Apache-2.0
"""The comparison of two runs of a benchmark."""

import json
import subprocess
import sys
from pathlib import Path

COMPARE = Path(__file__).resolve().parents[2] / "tools" / "bench" / "compare.py"


def written(path, *, format_number=1, **seconds):
    """A file as `bench reconstruction --json` writes it."""
    record = {
        "format": format_number,
        "kernel": f"kernel of {path.stem}",
        "machine": "x86_64",
        "processor": "",
        "limits": {"reading 64 MB": 0.004},
        "tables": {"Methods": seconds},
    }
    path.write_text(json.dumps(record), encoding="utf-8")
    return str(path)


def compared(*files):
    return subprocess.run(
        [sys.executable, str(COMPARE), *files], capture_output=True, text=True, check=False
    )


def test_rows_that_both_have_are_compared(tmp_path):
    old = written(tmp_path / "old.json", fit=0.050, gone=1.0)
    new = written(tmp_path / "new.json", fit=0.020, added=1.0)
    found = compared(old, new)
    assert found.returncode == 0, found.stderr
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in found.stdout.splitlines()]
    assert ["fit", "50.00", "20.00", "2.50"] in rows
    assert ["reading 64 MB", "4.00", "4.00", "1.00"] in rows
    assert not any(row and row[0] in ("gone", "added") for row in rows)
    assert "old: kernel of old, on x86_64" in found.stdout


def test_another_file_is_refused(tmp_path):
    old = written(tmp_path / "old.json", fit=1.0)
    strange = written(tmp_path / "strange.json", format_number=2, fit=1.0)
    found = compared(old, strange)
    assert found.returncode == 1
    assert "strange.json was not written by a benchmark with --json" in found.stderr
