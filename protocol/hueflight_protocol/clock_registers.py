# SPDX-License-Identifier: Apache-2.0
"""Registers of an external clock, at the same addresses on both boards."""

from .registers import Access, Field, Register, value

EXTERNAL_CLOCK = Field("external_clock", 1, "the board can run from an external clock")
"""Feature of a build with these registers."""
REFERENCE_LOST = Field("reference_lost", 1, "the external clock was lost while in use")
"""Fault of a build with these registers."""


def clock_registers(reference_hz: int, /) -> list[Register]:
    """Return the registers with which the host chooses the clock.

    Parameters
    ----------
    reference_hz : int
        Frequency of the external clock.
    """
    return [
        Register(
            "clock_state",
            0x013,
            Access.RO,
            (
                Field("external", 1, "the external clock is in use"),
                Field("present", 1, "there is an external clock of the right frequency"),
                Field("lost", 1, "it was lost while in use; until it is asked for again"),
            ),
            "clock in use, in builds with an external clock",
        ),
        Register(
            "reference_hz",
            0x014,
            Access.CONST,
            value(32, "", reset=reference_hz, unit="Hz"),
            "frequency that the external clock must have, in builds with one",
        ),
        Register(
            "clock_source",
            0x016,
            Access.RW,
            (Field("external", 1, "run from the external clock; asks anew when it becomes 1"),),
            "clock that is wanted, in builds with an external one: a change disarms an illuminator "
            "and ends the capture of a camera",
        ),
    ]


def clock_failures(address: int, /) -> Register:
    """Return the counter of failures of the clock; the boards have it at different addresses.

    Parameters
    ----------
    address : int
        Word address.
    """
    return Register(
        "clock_failures",
        address,
        Access.RO,
        value(16, "number"),
        "failures of the clock (the PLL lost lock) since configuration, saturating",
    )
