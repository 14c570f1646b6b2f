# SPDX-License-Identifier: Apache-2.0
"""Clients of the capture daemon: live pictures, recordings and calibrations over the network.

They need neither the devices nor the daemon, only the package websockets (extra
``hueflight[client]``).
"""

from typing import TYPE_CHECKING

from hueflight.lazy import lazy_names as _lazy_names

if TYPE_CHECKING:
    from hueflight.client.async_client import AsyncClient, connect_async
    from hueflight.client.errors import (
        ClientError,
        ConnectionLostError,
        NoPictureError,
        NotReachableError,
        RefusedError,
        TokenError,
        VersionMismatchError,
    )
    from hueflight.client.sync_client import Client, connect
    from hueflight.client.types import CaptureKind, Delivery, Exposure, RemoteRecording

#: module of each public name
_HOME = {
    "AsyncClient": "hueflight.client.async_client",
    "CaptureKind": "hueflight.client.types",
    "Client": "hueflight.client.sync_client",
    "ClientError": "hueflight.client.errors",
    "ConnectionLostError": "hueflight.client.errors",
    "Delivery": "hueflight.client.types",
    "Exposure": "hueflight.client.types",
    "NoPictureError": "hueflight.client.errors",
    "NotReachableError": "hueflight.client.errors",
    "RefusedError": "hueflight.client.errors",
    "RemoteRecording": "hueflight.client.types",
    "TokenError": "hueflight.client.errors",
    "VersionMismatchError": "hueflight.client.errors",
    "connect": "hueflight.client.sync_client",
    "connect_async": "hueflight.client.async_client",
}

__all__ = [
    "AsyncClient",
    "CaptureKind",
    "Client",
    "ClientError",
    "ConnectionLostError",
    "Delivery",
    "Exposure",
    "NoPictureError",
    "NotReachableError",
    "RefusedError",
    "RemoteRecording",
    "TokenError",
    "VersionMismatchError",
    "connect",
    "connect_async",
]

__getattr__, __dir__ = _lazy_names(__name__, _HOME)
