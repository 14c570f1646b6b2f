# SPDX-License-Identifier: Apache-2.0
"""Requests to the daemon's API, and its refusals as errors."""

from __future__ import annotations

import http.client
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from hueflight.client.address import Address
from hueflight.client.errors import (
    NotReachableError,
    RefusedError,
    TokenError,
    VersionMismatchError,
)
from hueflight.errors import HueflightError, OutputError
from hueflight.live.protocol import PROTOCOL

_BLOCK_BYTES = 1 << 20


class Requests:
    """Requests to one daemon, each on a connection of its own.

    Parameters
    ----------
    address : Address
        Where the daemon listens.
    token : str or None
        Token to send.
    timeout_s : float
        Time within which the daemon must answer.
    """

    def __init__(self, address: Address, /, *, token: str | None, timeout_s: float) -> None:
        self.address, self.token, self._timeout_s = address, token, timeout_s

    def ask(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request and return what the daemon answers.

        Parameters
        ----------
        method : str
            ``"GET"`` or ``"POST"``.
        path : str
            Path of the operation.
        body : dict, optional
            Body of the request.

        Returns
        -------
        dict
            The answer.

        Raises
        ------
        NotReachableError
            If nothing answers.
        TokenError
            If the daemon requires another token.
        RefusedError
            If the daemon refuses.
        VersionMismatchError
            If the answer is not one of a daemon.
        """
        content = None if body is None else msgspec.json.encode(body)
        with self._answer(method, path, content) as answer:
            return self._json(answer, answer.read())

    def check_protocol(self) -> dict[str, Any]:
        """Return the facts about the daemon's instrument, after a check of the protocol.

        Returns
        -------
        dict
            Answer of ``/api/instrument``.

        Raises
        ------
        VersionMismatchError
            If the daemon speaks another version of the protocol.
        """
        facts = self.ask("GET", "/api/instrument")
        spoken = facts.get("protocol")
        if spoken != PROTOCOL:
            raise VersionMismatchError(
                f"the daemon at {self.address.netloc} speaks {spoken or 'an older protocol'}, this "
                f"client {PROTOCOL}: install the same version of hueflight on both machines"
            )
        return facts

    def save(self, path: str, target: Path, /) -> None:
        """Save what the daemon sends.

        Parameters
        ----------
        path : str
            Path of the operation.
        target : Path
            File to write.

        Raises
        ------
        OutputError
            If the file can't be written.
        NotReachableError
            If the daemon stops sending.
        """
        with self._answer("GET", path, None) as answer:
            if answer.status != 200:
                self._json(answer, answer.read())
            try:
                file = target.open("wb")
            except OSError as error:
                raise OutputError(f"can't write {str(target)!r}: {error.strerror}") from None
            with file:
                self._copy(answer, file, target)

    def _copy(self, answer: http.client.HTTPResponse, file: Any, target: Path) -> None:
        expected = int(answer.getheader("content-length", "0"))
        size = 0
        while block := answer.read(_BLOCK_BYTES):
            size += len(block)
            try:
                file.write(block)
            except OSError as error:
                raise OutputError(f"can't write {str(target)!r}: {error.strerror}") from None
        if size != expected:
            raise NotReachableError(
                f"the daemon at {self.address.netloc} sent {size} of {expected} bytes of "
                f"{target.name!r}: download it again"
            )

    @contextmanager
    def _answer(
        self, method: str, path: str, content: bytes | None
    ) -> Iterator[http.client.HTTPResponse]:
        where = self.address
        if where.secure:
            connection: http.client.HTTPConnection = http.client.HTTPSConnection(
                where.host,
                where.port,
                timeout=self._timeout_s,
                context=ssl.create_default_context(),
            )
        else:
            connection = http.client.HTTPConnection(where.host, where.port, timeout=self._timeout_s)
        headers = {"host": where.netloc, "connection": "close"}
        if content is not None:
            headers["content-type"] = "application/json"
        if self.token is not None:
            headers["authorization"] = f"Bearer {self.token}"
        try:
            connection.request(method, path, body=content, headers=headers)
            yield connection.getresponse()
        except HueflightError:
            raise  # some are OSErrors, too, but not of the network
        except http.client.HTTPException as error:
            raise NotReachableError(
                f"{where.netloc} does not answer as a daemon does: {error!r}"
            ) from None
        except OSError as error:
            raise NotReachableError(
                f"no daemon can be reached at {where.netloc}: {error.strerror or error}: is "
                "'hueflight serve' running there, with server.host and port as given here?"
            ) from None
        finally:
            connection.close()

    def _json(self, answer: http.client.HTTPResponse, content: bytes) -> Any:
        try:
            found = msgspec.json.decode(content, type=dict[str, Any])
        except (msgspec.DecodeError, UnicodeDecodeError):
            raise VersionMismatchError(
                f"what answers at {self.address.netloc} is not a Hueflight daemon of this "
                f"version: status {answer.status}, no JSON object"
            ) from None
        if answer.status == 200:
            return found
        reason = str(found.get("error", f"status {answer.status}"))
        if answer.status == 401:
            sent = "none was sent" if self.token is None else "the one that was sent is another one"
            raise TokenError(
                f"the daemon at {self.address.netloc} requires its token, and {sent}: pass "
                "token=, the content of the file that server.token_file names there"
            )
        raise RefusedError(f"the daemon refuses: {reason}", status=answer.status)
