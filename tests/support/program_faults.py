# SPDX-License-Identifier: Apache-2.0
"""Faults of the program itself, in a daemon of its own process: a file asks for one."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def install(folder: Path) -> None:
    """Have parts of this process fail when a file with the name of the part is in `folder`.

    A file that is not empty names the exception; ``hang`` waits until the file is gone.
    """
    from hueflight.acquisition import runner
    from hueflight.acquisition.states import State, TransitionError
    from hueflight.daemon.pictures import Pictures
    from hueflight.recording import RecordingWriter

    def failing(part: str, work: Callable[..., Any]) -> Callable[..., Any]:
        asked = folder / part

        def wrapped(*args: Any, **kwargs: Any) -> Any:
            if asked.exists():
                kind = asked.read_text()
                if kind == "hang":
                    while asked.exists():
                        time.sleep(0.02)
                else:
                    asked.unlink(missing_ok=True)
                    if kind == "transition":
                        raise TransitionError(f"asked for: {part}")
                    raise ZeroDivisionError(f"asked for: {part}")
            return work(*args, **kwargs)

        return wrapped

    runner.WORK[State.RUNNING] = failing("acquisition", runner.WORK[State.RUNNING])
    # methods are replaced in the running program: that is what this module is for
    Pictures._make = failing("pictures", Pictures._make)  # type: ignore[method-assign]
    RecordingWriter.write = failing("recorder", RecordingWriter.write)  # type: ignore[method-assign]
