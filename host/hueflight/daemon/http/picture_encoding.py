# SPDX-License-Identifier: Apache-2.0
"""Encodes a picture in a thread of its own, while the next one is made."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from hueflight.daemon.picture import Picture


class PictureEncoding:
    """Hands pictures to a function, one after the other, in a thread of its own.

    Parameters
    ----------
    encode : callable
        Called with each picture, which comes without its histogram.
    """

    def __init__(self, encode: Callable[[Picture], None], /) -> None:
        self._encode = encode
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="encoding")
        self._latest: Future[None] | None = None

    def offer(self, picture: Picture, /) -> None:
        """Encode a picture next; wait until the one before is encoded.

        What the function raised for the picture before is raised here, so that whoever makes
        pictures is told of it.

        Parameters
        ----------
        picture : Picture
            The picture.
        """
        latest, self._latest = self._latest, None
        if latest is not None:
            latest.result()
        self._latest = self._thread.submit(self._encode, picture.without_histogram())

    def close(self) -> None:
        """Encode what was offered, and end the thread."""
        self._thread.shutdown()
