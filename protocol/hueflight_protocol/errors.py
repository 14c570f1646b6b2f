# SPDX-License-Identifier: Apache-2.0
"""The one exception family of Hueflight.

Everything that goes wrong in an expected way is a `HueflightError`; each room of the
house derives its own classes from it. A message quotes the bad value, says where it stood
and what to do about it. Programs catch the root and print the message alone.
"""


class HueflightError(Exception):
    """Root of every expected failure in gateware, protocol and host."""


class ProtocolError(HueflightError):
    """Bytes or values that the wire format or the control protocol does not allow."""


class PacketError(ProtocolError):
    """A packet that breaks a rule of the wire format.

    Parameters
    ----------
    message : str
        What was wrong, with the value.
    rule : str
        Number of the broken rule in the specification, such as ``"F7"``.
    offset : int
        Byte within the packet at which the offending value stands.
    """

    def __init__(self, message: str, *, rule: str, offset: int) -> None:
        super().__init__(f"{message} (byte {offset} of the packet, rule {rule})")
        self.rule = rule
        self.offset = offset


class AbortedFrameError(PacketError):
    """A well-formed frame packet whose trailer says that the camera gave the frame up.

    Parameters
    ----------
    message : str
        What was wrong, with the value.
    rule : str
        Number of the rule in the specification.
    offset : int
        Byte of the packet where it stood.
    """


class MessageError(ProtocolError):
    """A control message that is not well-formed; a device drops it and counts it.

    Parameters
    ----------
    message : str
        What was wrong, with the value.
    rule : str
        Number of the broken rule in the specification, such as ``"C4"``.
    """

    def __init__(self, message: str, *, rule: str) -> None:
        super().__init__(f"{message} (rule {rule})")
        self.rule = rule


class RegisterError(ProtocolError):
    """An unknown register or field, or a value that does not fit it."""
