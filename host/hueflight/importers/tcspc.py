"""Histograms from PicoQuant PTU and Becker & Hickl SDT files.

Both count bins forward from the sync pulse: an instrument for them has
``direction = "forward"`` and ``code_zero = "bin"``. `tcspc_instrument` makes one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, log2
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import FileFormatError, HueflightError, InstrumentError
from hueflight.files import import_optional
from hueflight.model.instrument import Band, Instrument, Sensor, Timing
from hueflight.model.time_bins import TimeBins

BIN_WIDTH_TOLERANCE = 1e-3  #: of the bin width; over a whole period it moves a pulse a bin or so


@dataclass(frozen=True)
class _Decays:
    """Counts (row, col, bin) as the file holds them.

    Attributes
    ----------
    period_ns : of the sync signal, where the file says.
    """

    counts: NDArray[Any]
    bin_width_ns: float
    period_ns: float | None


def read_ptu(path: Path, instrument: Instrument, *, channel: int | None) -> NDArray[Any]:
    """Histogram (row, col, code) of a PTU file of T3 mode, all its frames together.

    Raises
    ------
    FileFormatError
        If the file is not one, or has no such channel.
    InstrumentError
        If it does not fit the instrument.
    """
    return _coded(_ptu_decays(path, channel), instrument, path)


def read_sdt(path: Path, instrument: Instrument, *, block: str | None) -> NDArray[Any]:
    """Histogram (row, col, code) of a data block of an SDT file.

    Raises
    ------
    FileFormatError
        If the file is not one, or has no such block.
    InstrumentError
        If it does not fit the instrument.
    """
    return _coded(_sdt_decays(path, block), instrument, path)


def tcspc_instrument(
    path: str | Path,
    bands: Iterable[Band],
    /,
    *,
    name: str | None = None,
    channel: int | None = None,
    block: str | None = None,
) -> Instrument:
    """An instrument for a PTU or SDT file: its pixels, bins and period, and your bands.

    Parameters
    ----------
    path : ``.ptu`` or ``.sdt``.
    bands : wavelengths and delays of the sources, which such files don't hold.
    name : of the instrument; default the file's.
    channel, block : as for `read_counts`.

    Raises
    ------
    FileFormatError
        If the file can't be read.
    InstrumentError
        If bands and file contradict.
    """
    path = Path(path)
    if path.suffix.lower() not in (".ptu", ".sdt"):
        raise FileFormatError(f"{str(path)!r} is neither a .ptu nor an .sdt file")
    ptu = path.suffix.lower() == ".ptu"
    decays = _ptu_decays(path, channel) if ptu else _sdt_decays(path, block)
    rows, cols, bins = decays.counts.shape
    needed = bins
    if decays.period_ns is not None:
        needed = max(bins, TimeBins.codes_needed(decays.period_ns, decays.bin_width_ns))
    return Instrument(
        name=name or path.stem,
        description=f"from {path.name}",
        sensor=Sensor(
            rows=rows,
            cols=cols,
            code_bits=max(1, ceil(log2(needed))),
            bin_width_ns=decays.bin_width_ns,
        ),
        timing=Timing(period_ns=decays.period_ns),
        bands=tuple(bands),
    )


def _ptu_decays(path: Path, channel: int | None) -> _Decays:
    ptufile = import_optional("ptufile", extra="import")
    try:
        with ptufile.PtuFile(path) as ptu:
            if not ptu.is_t3:
                raise FileFormatError(
                    f"{str(path)!r} was measured in T2 mode: it has no time within a period; T3 "
                    "is needed"
                )
            active = list(ptu.active_channels)
            if channel is None and len(active) > 1:
                raise FileFormatError(
                    f"{str(path)!r} has photons in channels {active}: say which with channel="
                )
            if channel is not None and channel not in active:
                raise FileFormatError(
                    f"{str(path)!r} has no photons in channel {channel}; it has {active}"
                )
            which = active.index(channel) if channel is not None else 0
            if ptu.is_image:
                # all frames added up; 32 bits so that bright pixels don't wrap
                cube = ptu.decode_image(frame=-1, channel=which, dtype=np.uint32, keepdims=True)
                counts = cube[0, :, :, 0, :]
            else:
                counts = ptu.decode_histogram()[which][None, None]
            return _Decays(
                counts, float(ptu.tcspc_resolution) * 1e9, float(ptu.global_resolution) * 1e9
            )
    except HueflightError:
        raise
    except Exception as error:  # the reader fails in many ways on what is damaged
        raise FileFormatError(f"{str(path)!r} can't be read as PTU: {error}") from error


def _sdt_decays(path: Path, block: str | None) -> _Decays:
    sdtfile = import_optional("sdtfile", extra="import")
    try:
        # opened here, since the reader leaves a damaged file open
        with path.open("rb") as file:
            sdt = sdtfile.SdtFile(file)
            blocks, times = list(sdt.data), list(sdt.times)
    except Exception as error:  # the reader fails in many ways on what is damaged
        raise FileFormatError(f"{str(path)!r} can't be read as SDT: {error}") from error
    if not blocks:
        raise FileFormatError(f"{str(path)!r} holds no data block")
    if block is None and len(blocks) > 1:
        shapes = ", ".join(f"{i}: {data.shape}" for i, data in enumerate(blocks))
        raise FileFormatError(
            f"{str(path)!r} holds {len(blocks)} data blocks ({shapes}): say which with dataset="
        )
    number = block or "0"
    if not number.isdecimal() or int(number) >= len(blocks):
        raise FileFormatError(
            f"{str(path)!r} has no data block {block!r}: there are 0 to {len(blocks) - 1}"
        )
    data, time_s = blocks[int(number)], times[int(number)]
    if data.ndim > 3 or data.shape[-1] < 2:
        raise FileFormatError(
            f"{str(path)!r}: data block {number} of shape {data.shape} is no image of decays"
        )
    counts = data.reshape((1,) * (3 - data.ndim) + data.shape)
    return _Decays(counts, float(time_s[1] - time_s[0]) * 1e9, None)


def _coded(decays: _Decays, instrument: Instrument, path: Path) -> NDArray[Any]:
    """Counts on the instrument's codes, if they can be its."""
    sensor = instrument.sensor
    if sensor.direction != "forward" or sensor.reports_empty:
        raise InstrumentError(
            f"{str(path)!r} counts bins forward from 0, but instrument {instrument.name!r} has "
            f"direction {sensor.direction!r} and code_zero {sensor.code_zero!r}: use "
            "'forward' and 'bin'"
        )
    apart = abs(decays.bin_width_ns / sensor.bin_width_ns - 1)
    if apart > BIN_WIDTH_TOLERANCE:
        raise InstrumentError(
            f"{str(path)!r} has bins of {decays.bin_width_ns:g} ns, instrument "
            f"{instrument.name!r} of {sensor.bin_width_ns:g} ns"
        )
    if decays.counts.shape[:2] != instrument.image_shape:
        raise InstrumentError(
            f"{str(path)!r} has {decays.counts.shape[:2]} pixels (row, col), instrument "
            f"{instrument.name!r} has {instrument.image_shape}"
        )
    bins, codes = decays.counts.shape[-1], sensor.codes
    if bins <= codes:
        return np.pad(decays.counts, ((0, 0), (0, 0), (0, codes - bins)))
    if decays.counts[..., codes:].any():
        last = int(np.flatnonzero(decays.counts.any(axis=(0, 1)))[-1])
        raise InstrumentError(
            f"{str(path)!r} has photons up to bin {last}, but sensor.code_bits = "
            f"{sensor.code_bits} gives {codes} codes: use more bits"
        )
    return decays.counts[..., :codes]
