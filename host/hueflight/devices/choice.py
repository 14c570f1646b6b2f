"""Which rig to use: what is plugged in, or the simulated instrument, said aloud."""

from __future__ import annotations

from collections.abc import Callable

from hueflight.devices.rig import Connect, camera_plugged_in, hardware, simulated
from hueflight.model.instrument import Instrument

NOTICE = (
    "no camera is plugged in: using the SIMULATED instrument. Pictures and recordings are marked "
    "so; --no-simulate waits for a camera instead"
)


def choose_rig(
    instrument: Instrument,
    /,
    *,
    simulate: bool | None,
    serial: str | None,
    illuminator: str | None,
    scene: str,
    say: Callable[[str], None],
) -> Connect:
    """How to open the rig that is asked for.

    Parameters
    ----------
    simulate : True or False to insist; None for the hardware if there is any.
    serial : number of the camera; naming one means hardware.
    illuminator : serial port of the illuminator; likewise. None if something else drives the LEDs.
    scene : that a simulated instrument looks at.
    say : told what was chosen where nobody insisted.
    """
    if simulate is None:
        simulate = serial is None and illuminator is None and not camera_plugged_in()
        if simulate:
            say(NOTICE)
    if simulate:
        return simulated(instrument, scene=scene)
    return hardware(serial, illuminator=illuminator, instrument=instrument)
