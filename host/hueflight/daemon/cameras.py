# SPDX-License-Identifier: Apache-2.0
"""The cameras of several daemons as one: listed, started, stopped and recorded together."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal

from hueflight.client.address import Address
from hueflight.client.requests import Requests
from hueflight.daemon.server_config import CameraConfig, read_token
from hueflight.errors import HueflightError

Action = Literal["start", "stop", "record", "end"]
PATHS: dict[Action, str] = {
    "start": "/api/start",
    "stop": "/api/stop",
    "record": "/api/recordings",
    "end": "/api/recordings/stop",
}
TIMEOUT_S = 5.0  #: for the answer of another daemon
Ask = Callable[[str, str, dict[str, Any] | None], dict[str, Any]]


class Cameras:
    """The daemon's own camera and those of other daemons.

    Parameters
    ----------
    others : sequence of CameraConfig
        The other daemons.

    Attributes
    ----------
    others : list of Requests
        Requests to the other daemons, in their order.

    Raises
    ------
    HueflightError
        If an address is none, or a token can't be read.
    """

    def __init__(self, others: tuple[CameraConfig, ...], /) -> None:
        self.others = [
            Requests(
                Address.parse(each.address),
                token=read_token(each.token_file) if each.token_file else None,
                timeout_s=TIMEOUT_S,
            )
            for each in others
        ]

    def listing(self, own: Ask, /) -> list[dict[str, Any]]:
        """Return all cameras, the daemon's own first.

        Parameters
        ----------
        own : callable
            Carries out a request to this daemon, given method, path and body.

        Returns
        -------
        list of dict
            Address (empty for the daemon's own), facts about the instrument or None, and why they
            are not known.
        """
        return [
            {"address": address, "instrument": answer, "error": error}
            for address, answer, error in self._ask_all(own, "GET", "/api/instrument", None)[0]
        ]

    def act(self, action: Action, body: dict[str, Any] | None, own: Ask, /) -> dict[str, Any]:
        """Have all cameras do something at the same time.

        Parameters
        ----------
        action : {"start", "stop", "record", "end"}
            What they do.
        body : dict or None
            Body of the request to each daemon.
        own : callable
            Carries out a request to this daemon, given method, path and body.

        Returns
        -------
        dict
            State of each camera or name of its recording, or why it refused, and the time within
            which all have answered.
        """
        answers, within_s = self._ask_all(own, "POST", PATHS[action], body)
        return {
            "cameras": [
                {
                    "address": address,
                    "state": (answer or {}).get("state"),
                    "name": (answer or {}).get("name"),
                    "error": error,
                }
                for address, answer, error in answers
            ],
            "within_s": within_s,
        }

    def _ask_all(
        self, own: Ask, method: str, path: str, body: dict[str, Any] | None
    ) -> tuple[list[tuple[str, dict[str, Any] | None, str]], float]:
        """Ask all daemons at once; address, answer and error of each, and the time it took."""
        targets: list[tuple[str, Ask]] = [("", own)]
        targets += [(each.address.netloc, each.ask) for each in self.others]
        ready = threading.Barrier(len(targets))

        def ask(address: str, send: Ask) -> tuple[str, dict[str, Any] | None, str, float, float]:
            ready.wait()
            begun_s = time.monotonic()
            try:
                answer, error = send(method, path, body), ""
            except HueflightError as refused:
                answer, error = None, str(refused)
            return address, answer, error, begun_s, time.monotonic()

        with ThreadPoolExecutor(len(targets), thread_name_prefix="cameras") as pool:
            found = list(pool.map(lambda target: ask(*target), targets))
        within_s = max(each[4] for each in found) - min(each[3] for each in found)
        return [each[:3] for each in found], within_s
