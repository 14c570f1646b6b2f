"""The one exception family of Hueflight.

Everything that goes wrong in an expected way is a `HueflightError`; each room of the
house derives its own classes from it. A message quotes the bad value, says where it stood
and what to do about it. Programs catch the root and print the message alone.
"""


class HueflightError(Exception):
    """Root of every expected failure in gateware, protocol and host."""


class ProtocolError(HueflightError):
    """Bytes or values that the wire format or the control protocol does not allow."""
