# SPDX-License-Identifier: Apache-2.0
"""Stale data filter: leaves out packets of an earlier run that a link still holds.

They were counted as lost when that run ended, and must not be counted again (rule S5 of the
protocol: packets carry the label of their run).
"""

from __future__ import annotations

from hueflight_protocol import PacketParser

STEP_BYTES = 4096  #: looked at in one go: the parser is slow, and the run most often begins at once


class StaleDataFilter:
    """Holds a stream back until the first intact packet of a run.

    Parameters
    ----------
    label : int
        The run's `capture` number.

    Attributes
    ----------
    found : bool
        True if the run has begun, so that everything that follows belongs to it.
    """

    def __init__(self, label: int, /) -> None:
        self.found = False
        self._label = label
        self._parser = PacketParser(keep_damage=0)
        self._pending = bytearray()
        self._offset = 0  # in the stream, of the first byte that is pending

    def cut(self, piece: bytes, /) -> bytes:
        """Take a piece of the stream.

        Parameters
        ----------
        piece : bytes
            Next piece of the stream.

        Returns
        -------
        bytes
            What of it, and of earlier pieces, belongs to the run.
        """
        if self.found:
            return piece
        for start in range(0, len(piece), STEP_BYTES):
            self._look_at(piece[start : start + STEP_BYTES])
            if self.found:
                own = bytes(self._pending) + piece[start + STEP_BYTES :]
                self._pending.clear()
                return own
        return b""

    def _look_at(self, step: bytes) -> None:
        """Keep what may belong to the run, or may be the start of a packet."""
        self._pending += step
        packets = self._parser.feed(step)
        starts = [each.offset for each in packets if each.content.header.capture == self._label]
        self.found = bool(starts)
        end = self._offset + len(self._pending)
        wanted = starts[0] if starts else end - self._parser.pending_bytes
        del self._pending[: wanted - self._offset]
        self._offset = wanted
