# SPDX-License-Identifier: Apache-2.0
"""The tables of link and serial rates, against the sizes that the wire format allows."""

import numpy as np
import pytest

from hueflight_hdl.boards.target import Options
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.link_rates import frame_table, packet_bytes, serial_table
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.link.uart import UartError
from hueflight_protocol.links import LINKS

FORM = FrameFormat()


@pytest.mark.parametrize("occupancy", [0.05, 0.3])
def test_sparse_packets_have_a_bitmap_and_their_hits(occupancy):
    """One bit a pixel and nine a photon; docs/protocol.md allows 6 % over that at 0.3."""
    expected = FORM.pixels / 8 + FORM.pixels * occupancy * FORM.code_bits / 8
    assert expected < packet_bytes(FORM, occupancy) < 1.13 * expected


def test_full_packets_have_all_codes():
    expected = FORM.pixels * FORM.code_bits / 8
    assert expected < packet_bytes(FORM, 1) < 1.015 * expected


def test_the_table_divides_rates_by_sizes():
    rows = [row.strip("| ").split(" | ") for row in frame_table(FORM).splitlines()]
    cells = {float(row[0]): [float(cell.replace(",", "")) for cell in row[1:]] for row in rows[2:]}
    usb = list(LINKS).index("USB 2")
    # 53.2 MB/s is what USB 2 carries at most
    np.testing.assert_allclose(cells[0.3][1 + usb] * cells[0.3][0], 53.248e6, rtol=1e-3)
    assert all(low > high for low, high in zip(cells[0.05][1:], cells[0.3][1:], strict=True))


def test_the_most_baud_is_what_the_build_accepts():
    target = find_target("illuminator", "hx8k")
    most = int(serial_table([target]).splitlines()[-1].split("|")[-2].replace(",", ""))
    find_target("illuminator", "hx8k", Options(settings={"baud": most}))
    with pytest.raises(UartError):
        find_target("illuminator", "hx8k", Options(settings={"baud": most + 1}))
