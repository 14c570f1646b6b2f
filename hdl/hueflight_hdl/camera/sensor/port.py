# SPDX-License-Identifier: Apache-2.0
"""The interface between the camera and a sensor's readout.

Rules for a readout:

1. Photons are detected while ``expose`` is high. One clock after it falls, ``read`` is high for
   one clock and requests the codes of that exposure, but never before the previous readout has
   ended. ``expose`` rises again before the end of a readout only if the sensor keeps codes
   while it exposes and the overlap is enabled; if the readout then takes longer than the
   exposure, ``read`` comes later.
2. Codes come in readout order, row after row and column after column, ``lanes`` of them in
   each clock in which ``beats.valid`` is high, the first in lane 0. Rows run on into each
   other; only in a frame's last beat may lanes be left over, and what they carry is ignored.
3. Code 0 means that no photon was detected.
4. ``first`` marks the beat with a frame's first pixel, ``row`` each beat with a row's first
   pixel, ``last`` the beat with the last pixel. They are redundant:
   a frame whose marks are in the wrong beats is aborted and counted as a fault.
5. The camera cannot make the sensor wait. Beats may come in every clock or with any pauses
   shorter than the camera's patience.
6. A readout that is not asked for is ignored.
"""

from __future__ import annotations

from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ..frame_format import FrameFormat


def sensor_beat_layout(form: FrameFormat, /) -> data.StructLayout:
    """Return the layout of one clock's codes and marks."""
    return data.StructLayout(
        {"codes": form.codes_layout(form.lanes), "first": 1, "row": 1, "last": 1}
    )


class SensorPort(wiring.Signature):
    """The sensor port, as the camera sees it.

    Parameters
    ----------
    form : FrameFormat
        Geometry, code width, lanes.

    Members
    -------
    expose : Out(1)
        Photons are detected.
    read : Out(1)
        Read the exposure out.
    beats : In(stream)
        See `sensor_beat_layout`; never waits.
    """

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        beats = stream.Signature(sensor_beat_layout(form), always_ready=True)
        super().__init__({"expose": Out(1), "read": Out(1), "beats": In(beats)})
