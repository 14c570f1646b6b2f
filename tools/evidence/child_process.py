# SPDX-License-Identifier: Apache-2.0
"""Runs in processes of their own, which may crash or hang without harm to the measurement."""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

LONGEST_S = 3  #: of a run, after which it is taken to hang


def in_child(
    work: Callable[[], dict[str, Any]], said: Path, *, longest_s: int = LONGEST_S
) -> dict[str, Any] | None:
    """Do work in a copy of this process; return what it returns, or None if that has ended.

    An error of the work itself is a finding of the measurement: it must not raise any.
    """
    said.unlink(missing_ok=True)
    child = os.fork()
    if not child:
        signal.alarm(longest_s)
        # what the interpreter prints of its own crashes would look like a failure of the tests
        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        try:
            found = work()
        except BaseException:
            findings = [f"the measurement failed: {traceback.format_exc()}"]
            found = {"failed": True, "outcome": "ended", "findings": findings}
        said.write_text(json.dumps(found))
        os._exit(0)
    os.waitpid(child, 0)
    return json.loads(said.read_text()) if said.exists() else None
