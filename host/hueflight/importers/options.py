# SPDX-License-Identifier: Apache-2.0
"""Options of reading counts, which say what to take from a file."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from hueflight.errors import FileFormatError, InstrumentError
from hueflight.model.instrument import Instrument

AXES = "row,col,code"  #: axes of an array of counts, unless others are named


@dataclass(frozen=True)
class ReadOptions:
    """What to take from a file that may hold more than one set of counts.

    Attributes
    ----------
    dataset : str, optional
        Name of an array, or number of a data block.
    axes : str
        Axes of the array, in its order.
    channel : int, optional
        Detection channel.
    """

    dataset: str | None = None
    axes: str = AXES
    channel: int | None = None

    def refuse_all_but(self, *used: str, path: Path) -> None:
        """Raise an error for options that the reader of a file does not use.

        Parameters
        ----------
        *used : str
            Names of the options that it uses.
        path : pathlib.Path
            Path of the file, for the message.

        Raises
        ------
        FileFormatError
            If another option differs from its default.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name not in used and value != field.default:
                raise FileFormatError(
                    f"{str(path)!r}: files of this kind have no {field.name}; leave "
                    f"{field.name} = {value!r} out (--{field.name})"
                )


def require_instrument(instrument: Instrument | None, path: Path, /) -> Instrument:
    """Return the instrument of a file that describes none itself.

    Parameters
    ----------
    instrument : Instrument, optional
        Instrument that was given.
    path : pathlib.Path
        Path of the file, for the message.

    Returns
    -------
    Instrument
        The instrument that was given.

    Raises
    ------
    InstrumentError
        If none was given.
    """
    if instrument is None:
        raise InstrumentError(
            f"{str(path)!r} does not say which instrument made its counts: give one (--instrument)"
        )
    return instrument
