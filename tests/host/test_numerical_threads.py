# SPDX-License-Identifier: Apache-2.0
"""Commands keep the libraries below NumPy to one thread: others wait in busy loops."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from hueflight.numerical_threads import ONE_THREAD

pytest.importorskip("threadpoolctl")

PROGRAM = """
from hueflight.cli import main
try:
    main(["--version"])
except SystemExit as stop:
    assert not stop.code, stop.code
import json, numpy, scipy.linalg, sys, threadpoolctl
counts = {pool["num_threads"] for pool in threadpoolctl.threadpool_info()}
print(json.dumps(sorted(counts)), file=sys.stderr)
"""


@pytest.mark.parametrize(("stated", "used"), [({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, 2)])
def test_commands_use_one_thread_unless_told_otherwise(stated: dict[str, str], used: int) -> None:
    if used > (os.cpu_count() or 1):
        pytest.skip("the libraries start no more threads than there are processors")
    environment = {name: text for name, text in os.environ.items() if name not in ONE_THREAD}
    finished = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True,
        env=environment | stated,
    )  # fmt: skip
    assert json.loads(finished.stderr.splitlines()[-1]) == [used]
