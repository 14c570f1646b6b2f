"""Where in a stream a run begins: a link may still hold packets of an earlier run.

They were booked as lost when that run was closed, and must not count again (rule S5 of the
protocol: a capture is told by its label).
"""

from __future__ import annotations

from hueflight_protocol import PacketParser


class Beginning:
    """Holds a stream back until the first intact packet of a run.

    Parameters
    ----------
    label : the run's `capture` number.

    Attributes
    ----------
    found : whether the run has begun: what follows is its own.
    """

    def __init__(self, label: int, /) -> None:
        self.found = False
        self._label = label
        self._parser = PacketParser(keep_damage=0)
        self._pending = bytearray()
        self._offset = 0  # in the stream, of the first byte that is pending

    def cut(self, piece: bytes, /) -> bytes:
        """Take a piece of the stream; return what of it, and of earlier pieces, is the run's."""
        if self.found:
            return piece
        self._pending += piece
        for packet in self._parser.feed(piece):
            if packet.content.header.capture == self._label:
                self.found = True
                own = bytes(self._pending[packet.offset - self._offset :])
                self._pending.clear()
                return own
        earlier = len(self._pending) - self._parser.pending_bytes
        del self._pending[:earlier]
        self._offset += earlier
        return b""
