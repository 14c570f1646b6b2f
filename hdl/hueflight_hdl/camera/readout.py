# SPDX-License-Identifier: Apache-2.0
"""What becomes of a readout, whether its codes are sent, added to sums, or both."""

from __future__ import annotations

from dataclasses import dataclass

from amaranth.hdl import Module, Mux, Signal, Value

from .exposure.control import ExposureControl
from .exposure.frame_guard import FrameGuard
from .formatter.formatter import FrameFormatter
from .reduction.reducer import Reducer


@dataclass(frozen=True)
class Readout:
    """Signals of the readout that is asked for.

    Where codes are sent, frames are counted by what becomes of these; of the sums, packets state
    how many frames they hold and miss.

    Parameters
    ----------
    read : Value
        To the guard of the formatter: a readout is asked for.
    busy, over, dropped, aborted, fault : Value
        As those of `FrameGuard`.
    begins : Value
        A frame's first beat is taken.
    sent : Value
        A frame was sent whole, or added to sums that are sent.
    hits : Value
        Codes other than 0 in it that were sent.
    sums_wait : Value or None
        There are sums to be sent; None in a build without.
    """

    read: Value
    busy: Value
    over: Value
    dropped: Value
    aborted: Value
    fault: Value
    begins: Value
    sent: Value
    hits: Value
    sums_wait: Value | None


def plain_readout(
    exposure: ExposureControl, guard: FrameGuard, formatter: FrameFormatter, /
) -> Readout:
    """Return the signals of a camera that sends codes.

    Parameters
    ----------
    exposure : ExposureControl
        Asks for readouts.
    guard, formatter : FrameGuard, FrameFormatter
        Way of the codes.

    Returns
    -------
    Readout
        The signals.
    """
    return Readout(
        read=exposure.read,
        busy=guard.busy,
        over=guard.over,
        dropped=guard.dropped,
        aborted=guard.aborted,
        fault=guard.fault,
        begins=formatter.begins,
        sent=formatter.sent,
        hits=formatter.hits,
        sums_wait=None,
    )


def reduced_readout(m: Module, codes: Readout, reducer: Reducer, /) -> Readout:
    """Return the signals of a camera that sends codes, sums or both.

    Parameters
    ----------
    m : Module
        To which the logic is added.
    codes : Readout
        Those of the way of the codes.
    reducer : Reducer
        Way of the sums.

    Returns
    -------
    Readout
        The signals. A readout is over when it is over on both ways.
    """
    over, codes_over, sums_over = Signal(), Signal(), Signal()
    codes_before, sums_before = Signal(), Signal()
    m.d.comb += [
        codes_over.eq(~reducer.codes | codes.over | codes_before),
        sums_over.eq(~reducer.sums | reducer.over | sums_before),
        over.eq(codes_over & sums_over),
    ]
    m.d.sync += [
        codes_before.eq(reducer.codes & codes_over & ~over),
        sums_before.eq(reducer.sums & sums_over & ~over),
    ]
    return Readout(
        read=codes.read & reducer.codes,
        busy=codes.busy | reducer.busy,
        over=over,
        dropped=Mux(reducer.codes, codes.dropped, reducer.dropped),
        aborted=Mux(reducer.codes, codes.aborted, reducer.aborted),
        fault=Mux(reducer.codes, codes.fault, reducer.fault),
        begins=Mux(reducer.codes, codes.begins, reducer.begins),
        sent=Mux(reducer.codes, codes.sent, reducer.added),
        hits=Mux(reducer.codes, codes.hits, 0),
        sums_wait=~reducer.idle,
    )
