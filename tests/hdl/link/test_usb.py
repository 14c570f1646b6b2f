# SPDX-License-Identifier: Apache-2.0
"""The camera's USB device against a model of a host: enumeration, control, and a lossless stream.

The host's CRCs are checked against published values before anything is believed of it.
"""

from itertools import islice

import numpy as np
import pytest

from hueflight_hdl.camera.camera import CameraConfig
from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.reference import synthetic_frames
from hueflight_hdl.testbench.cxxrtl import Simulation, compile_design
from hueflight_hdl.testbench.usb_host import BusErrors, UsbHost, crc5, crc16
from hueflight_protocol import Event, EventCode, Frame, PacketParser, control

# compiling the bench imports LUNA, which uses Amaranth's older records
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.slow,  # compiling camera and USB device takes a minute
]

CONFIG = CameraConfig(
    form=FrameFormat(rows=48, cols=32, code_bits=9, lanes=8, run=64, banks=8),
    buffer_words=1024,
    admit_words=512,
)
STREAM, CONTROL = 1, 2
GET_DESCRIPTOR, SET_ADDRESS, SET_CONFIGURATION = 6, 5, 9
DEVICE, CONFIGURATION, STRING = 0x100, 0x200, 0x300


@pytest.fixture(scope="module")
def compiled(simulator):
    from hueflight_hdl.testbench.usb_camera import CLOCKS, UsbCameraTestbench

    return compile_design(UsbCameraTestbench(CONFIG), clocks=CLOCKS), CLOCKS["usb"]


@pytest.fixture
def device(compiled):
    design, per_clock = compiled
    with Simulation(*design) as simulation:
        yield lambda errors=None: UsbHost(simulation, per_clock=per_clock, errors=errors)


def enumerate_device(host):
    assert host.reset()
    host.control_in(GET_DESCRIPTOR, DEVICE, 18)
    host.control_out(SET_ADDRESS, 42)
    host.address = 42
    host.control_out(SET_CONFIGURATION, 1)


class Requests:
    """Control messages over the bulk endpoints."""

    def __init__(self, host):
        self.host, self.number, self.registers = host, 0, CONFIG.registers()

    def ask(self, request):
        self.host.write_packet(CONTROL, control.encode_request(request))
        return control.decode_response(self.host.read(CONTROL))

    def write(self, name, **fields):
        self.number += 1
        register = self.registers[name]
        answer = self.ask(control.write(self.number, register.address, [register.encode(**fields)]))
        assert (answer.result, answer.transaction) == (control.Result.OK, self.number)

    def read(self, name):
        self.number += 1
        register = self.registers[name]
        answer = self.ask(control.read(self.number, register.address, register.words))
        assert (answer.result, answer.transaction) == (control.Result.OK, self.number)
        return register.decode(sum(word << 32 * i for i, word in enumerate(answer.payload)))


def test_the_host_s_checksums_are_those_of_usb():
    # catalogue of parametrised CRC algorithms: CRC-5/USB and CRC-16/USB of "123456789"
    digits = int.from_bytes(b"123456789", "little")
    assert crc5(digits, bits=72) == 0x19
    assert crc16(b"123456789") == 0xB4C8


def test_enumerates_at_high_speed_as_the_host_s_driver_expects(device):
    host = device()
    assert host.reset(), "no high-speed handshake"
    first = host.control_in(GET_DESCRIPTOR, DEVICE, 18)
    assert first[:2] == bytes([18, 1])
    assert first[8:12] == bytes.fromhex(
        "09120100"
    )  # as `hueflight.devices.transports.usb_identity` has it
    host.control_out(SET_ADDRESS, 42)
    host.address = 42
    head = host.control_in(GET_DESCRIPTOR, CONFIGURATION, 9)
    total = int.from_bytes(head[2:4], "little")
    whole = host.control_in(GET_DESCRIPTOR, CONFIGURATION, total)
    assert len(whole) == total
    found, interface, at = {}, None, 0
    while at < total:
        size, kind = whole[at], whole[at + 1]
        if kind == 4:
            interface = whole[at + 2]
            assert whole[at + 5] == 0xFF
        elif kind == 5:
            assert whole[at + 3] == 2, "a bulk endpoint"
            assert int.from_bytes(whole[at + 4 : at + 6], "little") == 512
            found.setdefault(interface, set()).add(whole[at + 2])
        at += size
    assert found == {0: {0x02, 0x82}, 1: {0x81}}
    host.control_out(SET_CONFIGURATION, 1)
    product = host.control_in(GET_DESCRIPTOR, STRING + first[15], 255, index=0x0409)
    assert product[2:].decode("utf-16-le").startswith("Hueflight camera")
    serial = host.control_in(GET_DESCRIPTOR, STRING + first[16], 255, index=0x0409)
    assert serial[2:].decode("utf-16-le") == "00000007"


def test_damaged_overlong_and_empty_requests_change_nothing(device):
    host = device()
    enumerate_device(host)
    requests = Requests(host)
    requests.write("exposure", value=5)
    register = requests.registers["exposure"]
    good = control.encode_request(control.write(9, register.address, [6]))
    broken = bytes([*good[:-1], good[-1] ^ 1])
    errors = requests.read("request_errors")
    for bad in (broken, good[:7], good + bytes(300), bytes(512)):
        host.write_packet(CONTROL, bad)
        assert host.read(CONTROL, tries=20) == b""
    assert requests.read("exposure")["value"] == 5
    after = requests.read("request_errors")
    assert after["crc"] == errors["crc"] + 1
    assert after["framing"] >= errors["framing"] + 3
    host.write_packet(CONTROL, good)
    assert control.decode_response(host.read(CONTROL)).result == control.Result.OK
    assert requests.read("exposure")["value"] == 6


@pytest.mark.parametrize(("exposure", "overload"), [(400, False), (8, True)])
def test_streams_through_a_bus_that_loses_packets(device, exposure, overload):
    """At a rate that the bus can carry no frame is lost; above it each is delivered or counted."""
    frames = 100
    errors = BusErrors(np.random.default_rng(3))
    host = device(errors)
    enumerate_device(host)
    requests = Requests(host)
    requests.write("synthetic", enable=1, source=1, occupancy=20000)
    requests.write("synthetic_seed", value=77)
    requests.write("exposure", value=exposure)
    requests.write("frame_limit", value=frames)
    errors.damaged = errors.unheard = 0.3
    requests.write("run", start=1)
    parser, packets = PacketParser(), []
    while not any(_ends(packet) for packet in packets):
        content = host.read(STREAM)
        assert content, "the stream ended before its last message"
        assert len(content) % 8 == 0, "a transfer ends where a packet ends"
        packets += [packet.content for packet in parser.feed(content)]
    report = parser.report
    assert report.damaged == report.missing == report.skipped_bytes == 0
    assert host.retries > frames / 10, "nothing went wrong on the bus: the test is void"
    errors.damaged = errors.unheard = 0.0
    lost = requests.read("frames_dropped")["value"] + requests.read("frames_aborted")["value"]
    got = {packet.header.frame: packet for packet in packets if isinstance(packet, Frame)}
    assert len(got) + lost == frames
    assert (lost > 0) == overload
    expected = islice(synthetic_frames(CONFIG.form, 1, seed=77, occupancy=20000), frames)
    for number, codes in enumerate(expected):
        if number in got:
            np.testing.assert_array_equal(got[number].codes, codes)


def _ends(packet):
    return isinstance(packet, Event) and packet.code == EventCode.RUN_STOPPED
