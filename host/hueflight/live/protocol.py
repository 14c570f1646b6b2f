# SPDX-License-Identifier: Apache-2.0
"""Names that the daemon and its clients agree on."""

from __future__ import annotations

from typing import Literal

VERSION = 1  #: of the messages and of the requests
PROTOCOL = f"hueflight.v{VERSION}"  #: subprotocol of the web socket
#: prefix of a subprotocol that holds the token: browsers can't set headers of a web socket
TOKEN_PROTOCOL = "hueflight.token."

#: how the values of a picture are coded: quantised for a screen, or as they were reconstructed
Coding = Literal["display", "exact"]
CODINGS: tuple[Coding, ...] = ("display", "exact")
#: which pictures a client that asks for them is sent: the newest one, or one after another
Delivery = Literal["newest", "all"]
DELIVERIES: tuple[Delivery, ...] = ("newest", "all")
