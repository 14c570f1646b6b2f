# SPDX-License-Identifier: Apache-2.0
"""Mask, region and time gate of the emulated camera, as the gateware applies them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.emulation.frame_template import Template
from hueflight_protocol import FrameFlags, RegisterFile, decode_frame, encode_frame
from hueflight_protocol.typed_registers import camera as registers


@dataclass(frozen=True)
class FrameFilter:
    """Replaces codes by 0 that the registers leave out.

    Attributes
    ----------
    keep : ndarray of bool, shape (row, col)
        Pixels that are sent.
    gate : tuple of int
        First and last code that is sent.
    flags : FrameFlags
        What the headers of filtered frames say.
    """

    keep: NDArray[np.bool_]
    gate: tuple[int, int]
    flags: FrameFlags

    @classmethod
    def of(cls, file: RegisterFile, /) -> FrameFilter | None:
        """Take the filter that the registers state.

        Parameters
        ----------
        file : RegisterFile
            Registers of the camera.

        Returns
        -------
        FrameFilter or None
            None if everything is sent.
        """
        chosen = file.load(registers.Filters)
        flags = (
            chosen.mask * FrameFlags.MASKED
            | chosen.roi * FrameFlags.ROI
            | chosen.gate * FrameFlags.GATED
        )
        if not flags:
            return None
        geometry = file.load(registers.Geometry)
        keep = np.ones((geometry.rows, geometry.cols), bool)
        if chosen.mask:
            words = [
                file.get(registers.PixelMask.NAME, word) for word in range(-(-keep.size // 32))
            ]
            bits = np.unpackbits(np.array(words, "<u4").view(np.uint8), bitorder="little")
            keep &= ~bits[: keep.size].astype(bool).reshape(keep.shape)
        if chosen.roi:
            rows, cols = file.load(registers.RoiRows), file.load(registers.RoiCols)
            inside = np.zeros_like(keep)
            inside[rows.first : rows.last + 1, cols.first : cols.last + 1] = True
            keep &= inside
        gate = file.load(registers.Gate)
        kept = (gate.first, gate.last) if chosen.gate else (0, registers.Gate.LAST_MAX)
        return cls(keep, kept, FrameFlags(flags))

    def apply(self, template: Template, /) -> Template:
        """Return a frame without what is left out.

        Parameters
        ----------
        template : Template
            What the sensor sees.

        Returns
        -------
        Template
            What is sent.
        """
        if template.filtered is not None and template.filtered[0] is self:
            return template.filtered[1]
        frame = decode_frame(template.stamp(sequence=0, timestamp=0, frame=0))
        codes = np.where(
            self.keep & (frame.codes >= self.gate[0]) & (frame.codes <= self.gate[1]),
            frame.codes,
            0,
        )
        header = frame.header
        made = Template(
            encode_frame(
                codes, sequence=0, frame=0, timestamp=0, code_bits=header.code_bits,
                run=header.run, periods=header.periods, geometry=header.geometry, step=header.step,
                flags=FrameFlags(header.flags | self.flags),
            )
        )  # fmt: skip
        template.filtered = (self, made)
        return made
