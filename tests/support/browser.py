# SPDX-License-Identifier: Apache-2.0
"""Headless Chromium in a process of its own, ended for certain: a hung page fails its test."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.daemon_process import PATIENCE_S

LONGEST_S = 240.0  #: of one test; calls that have no limit of their own end with the browser
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage", "--disable-quic", "--no-first-run", "--no-default-browser-check",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-extensions", "--disable-default-apps", "--remote-debugging-port=0",
]  # fmt: skip


def require_chromium() -> str:
    """Path of the browser; skip, saying so, where there is none."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("the page's tests need the Debian package chromium")
    return found


@contextlib.contextmanager
def open_browser(folder: Path) -> Iterator[Any]:
    """A browser with an empty profile in `folder`, driven by Playwright."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    command = [require_chromium(), *FLAGS, f"--user-data-dir={folder}", "about:blank"]
    with (folder.parent / "browser.log").open("wb") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
    late = threading.Event()

    def end() -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # a group of its own: renderers too

    def give_up() -> None:
        late.set()
        end()

    watch = threading.Timer(LONGEST_S, give_up)
    watch.daemon = True
    watch.start()
    try:
        address = _debugging_address(folder, process, folder.parent / "browser.log")
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.connect_over_cdp(address, timeout=PATIENCE_S * 1e3)
            try:
                yield browser
            finally:
                end()  # then the connection is gone, and leaving waits for nothing
    except Exception as error:
        if late.is_set():
            raise AssertionError(f"the page still worked after {LONGEST_S:g} s") from error
        raise
    finally:
        watch.cancel()
        end()
        process.wait(PATIENCE_S)


def _debugging_address(folder: Path, process: subprocess.Popen[bytes], log: Path) -> str:
    """Where the browser listens, as it writes into its profile."""
    told = folder / "DevToolsActivePort"
    deadline = time.monotonic() + PATIENCE_S
    while not (told.exists() and told.read_text().count("\n")):
        if process.poll() is not None or time.monotonic() > deadline:
            raise AssertionError(f"the browser did not start:\n{log.read_text()[-2000:]}")
        time.sleep(0.05)
    return f"http://127.0.0.1:{told.read_text().splitlines()[0]}"


def wait(page: Any, selector: str, text: str) -> None:
    """Until the element says `text`.

    A function, not an expression: Playwright evaluates an expression again at every look, which
    the page's Content-Security-Policy refuses from the second on.
    """
    page.wait_for_function(
        "([s, t]) => document.querySelector(s)?.textContent.includes(t)", arg=[selector, text]
    )
