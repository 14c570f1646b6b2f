# SPDX-License-Identifier: Apache-2.0
"""Registers that stand at the same addresses on both boards: identity and status."""

from .control import CONTROL_VERSION, IDENTITY_ADDRESS, STATUS_ADDRESS
from .registers import Access, Field, Parts, Register, value
from .wire import TEMPERATURE_UNKNOWN


def common_registers(
    board: bytes,
    *,
    clock_hz: int,
    features: Parts,
    state: Parts,
    faults: Parts,
) -> list[Register]:
    """Return the identity block and the status block of a board.

    Parameters
    ----------
    board : bytes
        Four ASCII letters that tell the boards apart.
    clock_hz : int
        Frequency of the clock that timestamps count.
    features, state, faults : tuple of Field or Reserved
        The board's own bits.
    """
    identity, status = IDENTITY_ADDRESS, STATUS_ADDRESS
    const, ro = Access.CONST, Access.RO
    versions = (
        Field("protocol", 8, "version of the control protocol", reset=CONTROL_VERSION),
        Field("patch", 8, "patch version of the gateware"),
        Field("minor", 8, "minor version of the gateware"),
        Field("major", 8, "major version of the gateware"),
    )
    errors = (
        Field("crc", 16, "messages whose CRC was wrong, saturating"),
        Field("framing", 16, "messages of impossible length or broken COBS, saturating"),
    )
    temperature = (
        Field(
            "value",
            32,
            "temperature of the FPGA; -2^31 = not measured",
            reset=TEMPERATURE_UNKNOWN,
            unit="m°C",
            signed=True,
        ),
    )
    letters = int.from_bytes(board, "little")
    return [
        Register(
            "board",
            identity,
            const,
            value(32, "ASCII letters, the first in the lowest byte", reset=letters),
            "kind of board: `HCAM`, the camera, or `HILL`, the illuminator",
        ),
        Register("versions", identity + 1, const, versions, "versions of protocol and gateware"),
        Register(
            "map",
            identity + 2,
            const,
            value(32, "CRC-32C of the map"),
            "fingerprint of the register map",
        ),
        Register(
            "serial",
            identity + 3,
            const,
            value(64, "serial number"),
            "serial number of the board",
            words=2,
        ),
        Register(
            "clock_hz",
            identity + 5,
            const,
            value(32, "", reset=clock_hz, unit="Hz"),
            "device clock",
        ),
        Register(
            "source",
            identity + 6,
            const,
            value(32, "start of the hash"),
            "first 32 bits of the source's hash",
        ),
        Register("features", identity + 7, const, features, "what this build can do"),
        Register("state", status, ro, state, "what the board is doing"),
        Register("faults", status + 1, Access.W1C, faults, "what went wrong since last cleared"),
        Register(
            "uptime", status + 2, ro, value(64, "", unit="clock"), "clocks since reset", words=2
        ),
        Register(
            "requests",
            status + 4,
            ro,
            value(32, "number of requests"),
            "requests answered, saturating",
        ),
        Register("request_errors", status + 5, ro, errors, "messages dropped"),
        Register("temperature", status + 6, ro, temperature, "temperature"),
        Register("scratch", status + 7, Access.RW, value(32, "any number"), "for trying the link"),
    ]
