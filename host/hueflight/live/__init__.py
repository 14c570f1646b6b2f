# SPDX-License-Identifier: Apache-2.0
"""Messages of live pictures: what the daemon sends and clients read, defined once for both.

The page *Live pictures* of the documentation specifies the format.
"""

from hueflight.live.image import message_of_image, picture_of_message
from hueflight.live.message import (
    Message,
    MessageError,
    Plane,
    VersionError,
    decode_message,
    encode_message,
)
from hueflight.live.protocol import CODINGS, DELIVERIES, PROTOCOL, TOKEN_PROTOCOL, VERSION

__all__ = [
    "CODINGS",
    "DELIVERIES",
    "PROTOCOL",
    "TOKEN_PROTOCOL",
    "VERSION",
    "Message",
    "MessageError",
    "Plane",
    "VersionError",
    "decode_message",
    "encode_message",
    "message_of_image",
    "picture_of_message",
]
