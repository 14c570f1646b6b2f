# SPDX-License-Identifier: Apache-2.0
"""Messages to systemd about readiness and health, as sd_notify(3) describes them."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping


def notify(message: str, /, *, environment: Mapping[str, str] = os.environ) -> bool:
    """Send a message to the service manager, if there is one.

    Parameters
    ----------
    message : str
        Assignments such as ``"READY=1"``, one per line.
    environment : mapping of str to str
        Environment, whose ``NOTIFY_SOCKET`` names the socket.

    Returns
    -------
    bool
        True if the message was sent.
    """
    address = environment.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")) or not hasattr(socket, "AF_UNIX"):
        return False
    if address.startswith("@"):  # an abstract name
        address = "\0" + address[1:]
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.setblocking(False)
        sock.sendto(message.encode(), address)
        return True
    return False


def watchdog_interval_s(environment: Mapping[str, str] = os.environ, /) -> float | None:
    """Return how often the service manager wants to hear that the daemon is well.

    Parameters
    ----------
    environment : mapping of str to str
        Environment, with ``WATCHDOG_USEC`` and ``WATCHDOG_PID``.

    Returns
    -------
    float or None
        Half of its patience, in seconds, as sd_watchdog_enabled(3) recommends; None if it does not
        watch this process.
    """
    microseconds = environment.get("WATCHDOG_USEC", "")
    process = environment.get("WATCHDOG_PID", "") or str(os.getpid())
    if not microseconds.isdecimal() or int(microseconds) == 0 or process != str(os.getpid()):
        return None
    return int(microseconds) / 2e6
