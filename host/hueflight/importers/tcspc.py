# SPDX-License-Identifier: Apache-2.0
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
from hueflight.importers.options import ReadOptions
from hueflight.importers.time_tags import time_tag_histograms
from hueflight.model.instrument import Band, Instrument, Sensor, Timing
from hueflight.model.time_bins import TimeBins
from hueflight.recognition import what_is, why_unreadable

BIN_WIDTH_TOLERANCE = 1e-3  #: relative; over a whole period it shifts a pulse by about a bin

RECORD_BYTES = 4  #: of an event in a PTU file
DECAY_BLOCKS = ("DECAY_BLOCK", "PAGE_BLOCK", "IMG_BLOCK")  #: of SDT files


@dataclass(frozen=True)
class _Decays:
    """Counts (row, col, bin) as in the file, and the period of the sync signal if it states it."""

    counts: NDArray[Any]
    bin_width_ns: float
    period_ns: float | None


def read_ptu(
    path: Path, instrument: Instrument | None, options: ReadOptions, /
) -> tuple[NDArray[Any], Instrument]:
    """Read the histogram of one channel of a PTU file, as the sum of all frames.

    Of files in T2 mode, which hold the absolute times of events, only measurements of one point are
    read: a photon's time is what has passed since the sync event before it.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    instrument : Instrument
        Instrument that made the counts, which such files do not describe.
    options : ReadOptions
        Detection channel.

    Returns
    -------
    counts : numpy.ndarray, shape (row, col, code)
        The histogram.
    instrument : Instrument
        The instrument.

    Raises
    ------
    FileFormatError
        If the file can't be read or is incomplete, or the channel has no photons.
    InstrumentError
        If the instrument is missing or does not fit the file.
    """
    options.refuse_all_but("channel", path=path)
    given = _given(instrument, path)
    width_ns = given.sensor.bin_width_ns
    return _coded(_ptu_decays(path, options.channel, width_ns), given, path), given


def read_sdt(
    path: Path, instrument: Instrument | None, options: ReadOptions, /
) -> tuple[NDArray[Any], Instrument]:
    """Read the histogram in a data block of an SDT file.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    instrument : Instrument
        Instrument that made the counts, which such files do not describe.
    options : ReadOptions
        Number of the data block, as `dataset`, and detection channel, where a block has several.

    Returns
    -------
    counts : numpy.ndarray, shape (row, col, code)
        The histogram.
    instrument : Instrument
        The instrument.

    Raises
    ------
    FileFormatError
        If the file can't be read, or has no such block.
    InstrumentError
        If the instrument is missing or does not fit the file.
    """
    options.refuse_all_but("dataset", "channel", path=path)
    given = _given(instrument, path)
    return _coded(_sdt_decays(path, options.dataset, options.channel), given, path), given


def tcspc_instrument(
    path: str | Path,
    bands: Iterable[Band],
    /,
    *,
    name: str | None = None,
    channel: int | None = None,
    block: str | None = None,
) -> Instrument:
    """Make an instrument with the pixels, bins and period of a PTU or SDT file.

    Parameters
    ----------
    path : str or pathlib.Path
        Path of a ``.ptu`` or ``.sdt`` file.
    bands : iterable of Band
        Wavelengths and delays of the light sources, which such files do not state.
    name : str, optional
        Name of the instrument; by default that of the file.
    channel : int, optional
        Detection channel; by default the only one with photons.
    block : str, optional
        Number of the data block of an SDT file; by default the only one.

    Returns
    -------
    Instrument
        The instrument.

    Raises
    ------
    FileFormatError
        If the file can't be read.
    InstrumentError
        If the bands contradict the file.
    """
    path = Path(path)
    if path.suffix.lower() not in (".ptu", ".sdt"):
        seems = what_is(path) if path.exists() else "no file that exists"
        raise FileFormatError(f"{str(path)!r} is {seems}: give a .ptu or .sdt file")
    ptu = path.suffix.lower() == ".ptu"
    decays = _ptu_decays(path, channel, None) if ptu else _sdt_decays(path, block, channel)
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


def _ptu_decays(path: Path, channel: int | None, bin_width_ns: float | None) -> _Decays:
    """Counts of a channel; in T2 mode, in bins of the given width."""
    ptufile = import_optional("ptufile", extra="import")
    try:
        with ptufile.PtuFile(path) as ptu:
            present = (path.stat().st_size - ptu.record_offset) // RECORD_BYTES
            if present < ptu.number_records:
                raise FileFormatError(
                    f"{str(path)!r} was cut short: its header announces {ptu.number_records} "
                    f"records, but it holds {max(present, 0)}. Copy or export it again"
                )
            if ptu.is_t3:
                return _t3_decays(path, ptu, channel)
            return _t2_decays(path, ptu, channel, bin_width_ns)
    except HueflightError:
        raise
    except Exception as error:  # the library raises many kinds of errors for damaged files
        raise FileFormatError(why_unreadable(path, error)) from error


def _t3_decays(path: Path, ptu: Any, channel: int | None) -> _Decays:
    active = sorted(ptu.active_channels)
    # the arrays have an axis of all channels from the first to the last with photons
    which = _chosen_channel(path, active, channel) - active[0]
    if ptu.is_image:
        # the sum of all frames; 32 bits, so that bright pixels do not overflow
        cube = ptu.decode_image(frame=-1, channel=which, dtype=np.uint32, keepdims=True)
        counts = cube[0, :, :, 0, :]
    else:
        counts = ptu.decode_histogram()[which][None, None]
    return _Decays(counts, float(ptu.tcspc_resolution) * 1e9, float(ptu.global_resolution) * 1e9)


def _t2_decays(path: Path, ptu: Any, channel: int | None, bin_width_ns: float | None) -> _Decays:
    if bin_width_ns is None:
        raise FileFormatError(
            f"{str(path)!r} was measured in T2 mode: it holds times of events, but no bins. "
            "Describe the instrument without it (--rows 1 --cols 1 --code-bits ... --bin-width ...)"
        )
    histograms, period_ns = time_tag_histograms(path, ptu, bin_width_ns=bin_width_ns)
    counts = histograms[_chosen_channel(path, sorted(histograms), channel)]
    return _Decays(counts[None, None], bin_width_ns, period_ns)


def _chosen_channel(path: Path, active: list[int], channel: int | None) -> int:
    """Return the channel that was asked for, or the only one with photons."""
    if not active:
        raise FileFormatError(f"{str(path)!r} has no photons in any channel")
    if channel is None and len(active) > 1:
        raise FileFormatError(
            f"{str(path)!r} has photons in channels {active}: say which with channel (--channel)"
        )
    if channel is not None and channel not in active:
        raise FileFormatError(f"{str(path)!r} has no photons in channel {channel}; it has {active}")
    return active[0] if channel is None else channel


def _sdt_decays(path: Path, block: str | None, channel: int | None) -> _Decays:
    sdtfile = import_optional("sdtfile", extra="import")
    try:
        # opened here, because the library leaves a damaged file open
        with path.open("rb") as file:
            sdt = sdtfile.SdtFile(file)
            blocks, times = list(sdt.data), list(sdt.times)
            kinds = [
                sdtfile.sdtfile.BlockType(head.block_type).contents for head in sdt.block_headers
            ]
    except Exception as error:  # the library raises many kinds of errors for damaged files
        raise FileFormatError(why_unreadable(path, error)) from error
    if not blocks:
        raise FileFormatError(f"{str(path)!r} holds no data block")
    decays = [number for number, kind in enumerate(kinds) if kind in DECAY_BLOCKS]
    if block is None and len(decays) != 1:
        listed = ", ".join(f"{i}: {kinds[i]} {data.shape}" for i, data in enumerate(blocks))
        raise FileFormatError(
            f"{str(path)!r} holds {len(blocks)} data blocks ({listed}), {len(decays)} of them with "
            "decays: say which with dataset (--dataset)"
        )
    number = str(decays[0]) if block is None else block
    if not number.isdecimal() or int(number) >= len(blocks):
        raise FileFormatError(
            f"{str(path)!r} has no data block {block!r}: there are 0 to {len(blocks) - 1}"
        )
    data, time_s, kind = blocks[int(number)], times[int(number)], kinds[int(number)]
    if kind not in DECAY_BLOCKS or data.shape[-1] < 2:
        raise FileFormatError(
            f"{str(path)!r}: data block {number} is a {kind} of shape {data.shape}, not decays "
            f"({', '.join(DECAY_BLOCKS)})"
        )
    counts = _sdt_channel(path, data, channel)
    return _Decays(counts, float(time_s[1] - time_s[0]) * 1e9, None)


def _sdt_channel(path: Path, data: NDArray[Any], channel: int | None) -> NDArray[Any]:
    """Counts (row, col, bin) of a channel of a block (channel..., row, col, bin)."""
    counts = data.reshape((1,) * (3 - data.ndim) + data.shape)
    counts = counts.reshape(-1, *counts.shape[-3:])
    active = [number for number, image in enumerate(counts) if image.any()]
    if counts.shape[0] == 1 and channel is None:
        return counts[0]
    return counts[_chosen_channel(path, active, channel)]


def _given(instrument: Instrument | None, path: Path) -> Instrument:
    if instrument is None:
        raise InstrumentError(
            f"{str(path)!r} does not say which bands there are: give an instrument "
            "(--instrument; hueflight instrument new --from FILE makes one)"
        )
    return instrument


def _folded(decays: _Decays, instrument: Instrument, path: Path) -> NDArray[Any]:
    """Return the counts with those beyond the period added to the bins of the same phase.

    Times are counted from a sync pulse. Where the next pulse was missed or the sync signal is
    divided, they exceed the period of the light, of which only their phase matters. A bin beyond
    the period goes to the bin in which its centre falls.
    """
    period_ns, width_ns = instrument.timing.period_ns, instrument.sensor.bin_width_ns
    bins = decays.counts.shape[-1]
    if period_ns is None:
        return decays.counts
    used = TimeBins.codes_needed(period_ns, width_ns)
    if not decays.counts[..., used:].any():
        return decays.counts[..., :used]
    if decays.period_ns is not None:
        pulses = decays.period_ns / period_ns
        if abs(pulses - max(1, round(pulses))) * period_ns > width_ns / 2:
            beyond = int(decays.counts[..., used:].sum(dtype=np.uint64))
            raise InstrumentError(
                f"{str(path)!r} has {beyond} photons beyond the period of {period_ns:g} ns of "
                f"instrument {instrument.name!r}, and its sync signal has a period of "
                f"{decays.period_ns:g} ns, which is no multiple of it: check timing.period_ns"
            )
    folded = decays.counts[..., :used].astype(np.promote_types(decays.counts.dtype, np.uint32))
    for source in range(used, bins):
        target = int((source + 0.5) * width_ns % period_ns / width_ns)
        folded[..., target] += decays.counts[..., source]
    return folded


def _coded(decays: _Decays, instrument: Instrument, path: Path) -> NDArray[Any]:
    """Return the counts on the codes of the instrument, if it fits."""
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
    counts = _folded(decays, instrument, path)
    bins, codes = counts.shape[-1], sensor.codes
    if bins <= codes:
        return np.pad(counts, ((0, 0), (0, 0), (0, codes - bins)))
    if counts[..., codes:].any():
        last = int(np.flatnonzero(counts.any(axis=(0, 1)))[-1])
        raise InstrumentError(
            f"{str(path)!r} has photons up to bin {last}, but sensor.code_bits = "
            f"{sensor.code_bits} gives {codes} codes: use more bits"
        )
    return counts[..., :codes]
