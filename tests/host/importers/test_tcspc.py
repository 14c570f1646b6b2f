# SPDX-License-Identifier: Apache-2.0
"""PTU files written by `ptufile`, SDT files written here from the format's structures."""

import struct
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import ptufile
import pytest
from numpy.typing import NDArray

import hueflight as hf
from hueflight.errors import FileFormatError, InstrumentError
from hueflight.importers import read_counts, tcspc_instrument
from hueflight.model.instrument import Band
from support.sdt_file import write_sdt

ROWS, COLS, BINS, BIN_NS, PERIOD_NS = 5, 7, 125, 0.4, 50.0
BANDS = (
    Band(name="red", wavelength_nm=650, delay_ns=5, pulse_fwhm_ns=2),
    Band(name="blue", wavelength_nm=450, delay_ns=28, pulse_fwhm_ns=2),
)


@pytest.fixture(scope="module")
def camera() -> hf.Instrument:
    return hf.Instrument.from_toml(
        f"""
        name = "scanner"
        [sensor]
        rows = {ROWS}
        cols = {COLS}
        code_bits = 7
        bin_width_ns = {BIN_NS}
        [timing]
        period_ns = {PERIOD_NS}
        [[bands]]
        name = "red"
        wavelength_nm = 650
        delay_ns = 5
        pulse_fwhm_ns = 2
        [[bands]]
        name = "blue"
        wavelength_nm = 450
        delay_ns = 28
        pulse_fwhm_ns = 2
        """
    )


@pytest.fixture(scope="module")
def counts() -> NDArray[np.uint16]:
    drawn = np.random.default_rng(1).poisson(0.8, (ROWS, COLS, BINS)).astype(np.uint16)
    drawn[0, 0] = 0
    return drawn


def write_ptu(
    path: Path, counts: NDArray[Any], *, period_ns: float = PERIOD_NS, **options: Any
) -> None:
    ptufile.imwrite(
        path,
        np.ascontiguousarray(counts),
        global_resolution=period_ns * 1e-9,
        tcspc_resolution=BIN_NS * 1e-9,
        **options,
    )


def test_ptu_is_read_exactly(counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path) -> None:
    write_ptu(tmp_path / "a.ptu", counts)
    found, instrument = read_counts(tmp_path / "a.ptu", camera)
    assert instrument is camera
    np.testing.assert_array_equal(found[..., :BINS], counts)
    assert not found[..., BINS:].any()


def with_tags(path: Path, **values: int) -> None:
    """Change whole numbers in the header of a PTU file: 32 bytes name, index, type, value."""
    data = bytearray(path.read_bytes())
    for name, value in values.items():
        struct.pack_into("<q", data, data.index(name.encode().ljust(32, b"\0")) + 40, value)
    path.write_bytes(data)


T3_KINDS = [kind for kind in ptufile.PtuRecordType if kind.name.endswith("T3")]
T2_KINDS = [kind for kind in ptufile.PtuRecordType if kind.name.endswith("T2")]


@pytest.mark.parametrize("kind", T3_KINDS, ids=lambda kind: kind.name)
def test_ptu_records_of_every_device_in_t3_mode(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path, kind: ptufile.PtuRecordType
) -> None:
    """The library writes two layouts; the others have one of these, without overflows."""
    written = kind if kind.name.startswith("Pico") else ptufile.PtuRecordType.GenericT3
    few = np.minimum(counts, 1)  # in a short measurement, no counter overflows
    write_ptu(tmp_path / "a.ptu", few, record_type=written)
    with_tags(tmp_path / "a.ptu", TTResultFormat_TTTRRecType=int(kind))
    with ptufile.PtuFile(tmp_path / "a.ptu") as file:
        assert file.record_type == kind
    found, _ = read_counts(tmp_path / "a.ptu", camera)
    np.testing.assert_array_equal(found[..., :BINS], few)


def test_ptu_scanned_in_both_directions(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path
) -> None:
    there_and_back = counts.copy()
    there_and_back[1::2] = there_and_back[1::2, ::-1]
    write_ptu(tmp_path / "a.ptu", there_and_back)
    with_tags(tmp_path / "a.ptu", ImgHdr_BiDirect=1)
    found, _ = read_counts(tmp_path / "a.ptu", camera)
    np.testing.assert_array_equal(found[..., :BINS], counts)


def write_t2(path: Path, kind: ptufile.PtuRecordType, events: list[tuple[str | int, int]]) -> None:
    """A T2 file of ticks of 100 ps, after PicoQuant's description of the records.

    An event is a channel, or ``"sync"`` or ``"marker"``, and its time in ticks.
    """
    write_ptu(path, np.ones((1, 1, 2), np.uint16))
    with ptufile.PtuFile(path) as file:
        header = path.read_bytes()[: file.record_offset]
    pico = kind.name == "PicoHarpT2"
    wrap = {"PicoHarpT2": 210_698_240, "HydraHarpT2": 33_552_000}.get(kind.name, 1 << 25)
    records, overflows = [], 0
    for event, time in events:
        while time - overflows * wrap >= wrap:
            records.append(0xF << 28 if pico else 1 << 31 | 0x3F << 25 | 1)
            overflows += 1
        at = time - overflows * wrap
        if pico:  # channel 0 is the sync input, 15 means a marker in the low bits
            channel = {"sync": 0, "marker": 15}[event] if isinstance(event, str) else event + 1
            records.append(channel << 28 | (at & ~0xF | 1 if event == "marker" else at))
        else:
            special = isinstance(event, str)
            channel = {"sync": 0, "marker": 1}[event] if isinstance(event, str) else event
            records.append(special << 31 | channel << 25 | at)
    path.write_bytes(header + np.array(records, "<u4").tobytes())
    with_tags(
        path, TTResultFormat_TTTRRecType=int(kind), Measurement_Mode=2, Measurement_SubMode=1,
        TTResult_NumberOfRecords=len(records),
        MeasDesc_GlobalResolution=int(np.float64(1e-10).view(np.int64)),
    )  # fmt: skip


@pytest.mark.parametrize("kind", T2_KINDS, ids=lambda kind: kind.name)
def test_ptu_records_of_every_device_in_t2_mode(
    camera: hf.Instrument, tmp_path: Path, kind: ptufile.PtuRecordType
) -> None:
    """Sync events every 50 ns for 0.03 s, in which every counter overflows."""
    point = camera.replace(sensor=msgspec.structs.replace(camera.sensor, rows=1, cols=1))
    rng = np.random.default_rng(7)
    events: list[tuple[str | int, int]] = [(0, 3)]  # before the first sync event
    truth = np.zeros((2, 128), np.uint32)
    for start in range(100, 300_000_000, 500_000):
        events += [("sync", start), ("sync", start + 500)]
        phase = int(rng.integers(500))
        channel = int(rng.integers(2))
        events += [("marker", start + 500), (channel, start + 500 + phase)]
        truth[channel, phase // 4] += 1  # bins of 0.4 ns
    events += [(0, 4_000_000_000), (1, 4_000_000_000)]  # long after the last sync event
    path = tmp_path / "a.ptu"
    write_t2(path, kind, events)
    active = [1, 2] if kind.name == "PicoHarpT2" else [0, 1]
    with pytest.raises(FileFormatError, match=rf"channels \[{active[0]}, {active[1]}\]: say which"):
        read_counts(path, point)
    for number, channel in enumerate(active):
        found, _ = read_counts(path, point, channel=channel)
        np.testing.assert_array_equal(found[0, 0], truth[number])
    with pytest.raises(FileFormatError, match=r"no bins\. Describe the instrument"):
        tcspc_instrument(path, BANDS)


def test_ptu_in_t2_mode_without_sync_events(camera: hf.Instrument, tmp_path: Path) -> None:
    write_t2(tmp_path / "a.ptu", ptufile.PtuRecordType.GenericT2, [(0, 5), ("sync", 9), (0, 20)])
    with pytest.raises(FileFormatError, match=r"has 1 sync events: without them"):
        read_counts(tmp_path / "a.ptu", camera)


def test_ptu_frames_are_added_up(camera: hf.Instrument, tmp_path: Path) -> None:
    frames = np.random.default_rng(2).poisson(0.3, (3, ROWS, COLS, BINS)).astype(np.uint16)
    write_ptu(tmp_path / "a.ptu", frames, has_frames=True)
    found, _ = read_counts(tmp_path / "a.ptu", camera)
    np.testing.assert_array_equal(found[..., :BINS], frames.sum(axis=0))


def test_ptu_channels(camera: hf.Instrument, tmp_path: Path) -> None:
    both = np.random.default_rng(3).poisson(0.3, (ROWS, COLS, 2, BINS)).astype(np.uint16)
    write_ptu(tmp_path / "a.ptu", both)
    with pytest.raises(FileFormatError, match=r"photons in channels \[0, 1\]: say which"):
        read_counts(tmp_path / "a.ptu", camera)
    for channel in (0, 1):
        found, _ = read_counts(tmp_path / "a.ptu", camera, channel=channel)
        np.testing.assert_array_equal(found[..., :BINS], both[:, :, channel])
    with pytest.raises(FileFormatError, match="no photons in channel 5"):
        read_counts(tmp_path / "a.ptu", camera, channel=5)


def test_ptu_channels_keep_their_numbers(camera: hf.Instrument, tmp_path: Path) -> None:
    """Channel c of 0, 2 and 3 has c + 1 counts a pixel in bin 10 c + 5; channel 1 has none."""
    cube = np.zeros((ROWS, COLS, 4, BINS), np.uint16)
    for channel in (0, 2, 3):
        cube[:, :, channel, 10 * channel + 5] = channel + 1
    path = tmp_path / "a.ptu"
    write_ptu(path, cube)
    for channel in (0, 2, 3):
        found, _ = read_counts(path, camera, channel=channel)
        np.testing.assert_array_equal(found[..., :BINS], cube[:, :, channel])
    with pytest.raises(FileFormatError, match=r"no photons in channel 1; it has \[0, 2, 3\]"):
        read_counts(path, camera, channel=1)


def test_ptu_channels_of_point_measurements(
    camera: hf.Instrument, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same without an image: all photons of a channel in one pixel."""
    cube = np.zeros((ROWS, COLS, 4, BINS), np.uint16)
    for channel in (1, 3):
        cube[:, :, channel, 10 * channel + 5] = channel + 1
    path = tmp_path / "a.ptu"
    write_ptu(path, cube)
    monkeypatch.setattr(ptufile.PtuFile, "is_image", False)
    point = camera.replace(sensor=msgspec.structs.replace(camera.sensor, rows=1, cols=1))
    for channel in (1, 3):
        found, _ = read_counts(path, point, channel=channel)
        np.testing.assert_array_equal(found[0, 0, :BINS], cube[:, :, channel].sum(axis=(0, 1)))


def test_ptu_photons_beyond_the_period_are_folded(camera: hf.Instrument, tmp_path: Path) -> None:
    """In a period of 19.9 ns, 49.75 bins of 0.4 ns, bin 50 (centre 20.2 ns) is bin 0."""
    timing = msgspec.structs.replace(camera.timing, period_ns=19.9)
    short = camera.replace(timing=timing, bands=camera.bands[:1])
    cube = np.zeros((ROWS, COLS, 110), np.uint16)
    cube[..., 7], cube[..., 49], cube[..., 50], cube[..., 57], cube[..., 107] = 1, 2, 4, 8, 16
    path = tmp_path / "a.ptu"
    write_ptu(path, cube, period_ns=19.9)
    found, _ = read_counts(path, short)
    wanted = {7: 1 + 8, 49: 2, 0: 4, 8: 16}  # bin 107: 43.0 - 39.8 = 3.2 ns
    for code, count in wanted.items():
        assert (found[..., code] == count).all(), code
    assert found.sum() == cube.sum()
    # every second pulse of the light is a sync pulse
    write_ptu(path, cube, period_ns=39.8)
    np.testing.assert_array_equal(read_counts(path, short)[0], found)
    write_ptu(path, cube, period_ns=50.0)
    with pytest.raises(InstrumentError, match=r"photons beyond the period of 19\.9 ns .* 50 ns"):
        read_counts(path, short)


def test_ptu_that_was_cut_short_is_refused(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path
) -> None:
    path = tmp_path / "a.ptu"
    write_ptu(path, counts)
    whole = path.read_bytes()
    for lost in (1, 4, len(whole) // 4):
        path.write_bytes(whole[:-lost])
        with pytest.raises(FileFormatError, match="was cut short: its header announces"):
            read_counts(path, camera)


def test_options_of_other_readers_are_refused(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path
) -> None:
    write_ptu(tmp_path / "a.PTU", counts)
    found, _ = read_counts(tmp_path / "a.PTU", camera)
    np.testing.assert_array_equal(found[..., :BINS], counts)
    with pytest.raises(FileFormatError, match="no dataset; leave dataset = 'x' out"):
        read_counts(tmp_path / "a.PTU", camera, dataset="x")


def test_instrument_from_a_file(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path
) -> None:
    write_ptu(tmp_path / "scan.ptu", counts)
    made = tcspc_instrument(tmp_path / "scan.ptu", BANDS)
    assert made.image_shape == (ROWS, COLS)
    assert made.timing.period_ns == pytest.approx(PERIOD_NS)
    assert made.sensor.bin_width_ns == pytest.approx(BIN_NS)
    assert made.sensor.codes == 128
    found, _ = read_counts(tmp_path / "scan.ptu", made)
    np.testing.assert_array_equal(found[..., :BINS], counts)


def test_ptu_to_depth_and_reflectance(camera: hf.Instrument, tmp_path: Path, draw: Any) -> None:
    """Through the file or straight into `reconstruct`: the same image."""
    reference = draw(camera, depth=0.5, photons=3000, seed=1).astype(np.uint16)
    target = draw(camera, depth=0.8, photons=2000, reflectance=[0.2, 1.0], seed=2)
    target = target.astype(np.uint16)
    for name, data in (("ref", reference), ("scene", target)):
        write_ptu(tmp_path / f"{name}.ptu", data[..., :BINS])
    cal = hf.calibrate(read_counts(tmp_path / "ref.ptu", camera)[0], camera, distance=0.5)
    image = hf.reconstruct(read_counts(tmp_path / "scene.ptu", camera)[0], cal)
    direct = hf.reconstruct(target, hf.calibrate(reference, camera, distance=0.5))
    np.testing.assert_array_equal(image["depth"], direct["depth"])
    # 35 pixels of about 1 cm each, so the mean is good to 2 mm; five times that
    assert float(image["depth"].mean()) == pytest.approx(0.8, abs=0.01)


@pytest.fixture
def shot(camera: hf.Instrument) -> hf.Instrument:
    """The same scanner with 128 bins and no period: SDT files don't state one."""
    return camera.replace(timing=msgspec.structs.replace(camera.timing, period_ns=None))


def test_sdt_is_read_exactly(shot: hf.Instrument, tmp_path: Path) -> None:
    cube = np.random.default_rng(4).poisson(2.0, (ROWS, COLS, 128)).astype(np.uint16)
    write_sdt(tmp_path / "a.sdt", [cube], BIN_NS * 1e-9)
    found, _ = read_counts(tmp_path / "a.sdt", shot)
    np.testing.assert_array_equal(found, cube)
    made = tcspc_instrument(tmp_path / "a.sdt", BANDS, name="bh")
    assert made.sensor.bin_width_ns == pytest.approx(BIN_NS)
    assert made.histogram_shape == (ROWS, COLS, 128)


def test_sdt_blocks(shot: hf.Instrument, tmp_path: Path) -> None:
    cubes = [
        np.random.default_rng(seed).poisson(2.0, (ROWS, COLS, 128)).astype(np.uint16)
        for seed in (5, 6)
    ]
    write_sdt(tmp_path / "a.sdt", cubes, BIN_NS * 1e-9)
    for number, cube in enumerate(cubes):
        found, _ = read_counts(tmp_path / "a.sdt", shot, dataset=str(number))
        np.testing.assert_array_equal(found, cube)
    with pytest.raises(FileFormatError, match=r"holds 2 data blocks .* 2 of them with decays"):
        read_counts(tmp_path / "a.sdt", shot)
    with pytest.raises(FileFormatError, match="no data block '2': there are 0 to 1"):
        read_counts(tmp_path / "a.sdt", shot, dataset="2")


SDT_KINDS = {
    "decay": 0x01, "page": 0x11, "image": 0x61, "from a stream": 0x68, "simulated": 0x15,
    "32 bits": 0x161, "floating point": 0x264, "compressed": 0x1061, "compressed, 32": 0x1161,
}  # fmt: skip


@pytest.mark.parametrize("kind", SDT_KINDS.values(), ids=SDT_KINDS.keys())
def test_sdt_blocks_of_every_kind(shot: hf.Instrument, tmp_path: Path, kind: int) -> None:
    dtype = {0x000: "<u2", 0x100: "<u4", 0x200: "<f8"}[kind & 0xF00]
    cube = np.random.default_rng(4).poisson(2.0, (ROWS, COLS, 128)).astype(dtype)
    write_sdt(tmp_path / "a.sdt", [cube], BIN_NS * 1e-9, kind=kind)
    found, _ = read_counts(tmp_path / "a.sdt", shot)
    np.testing.assert_array_equal(found, cube)


@pytest.mark.parametrize("content", [0x20, 0x30, 0x40, 0x50, 0x90, 0xA0, 0xC0])
def test_sdt_blocks_without_decays_are_refused(
    shot: hf.Instrument, tmp_path: Path, content: int
) -> None:
    cube = np.ones((ROWS, COLS, 128), np.uint16)
    write_sdt(tmp_path / "a.sdt", [cube], BIN_NS * 1e-9, kind=0x01 | content)
    with pytest.raises(FileFormatError, match=r"0: \w+_BLOCK .* 0 of them with decays"):
        read_counts(tmp_path / "a.sdt", shot)
    with pytest.raises(FileFormatError, match=r"data block 0 is a \w+_BLOCK .* not decays"):
        read_counts(tmp_path / "a.sdt", shot, dataset="0")


def test_sdt_channels_of_a_router(shot: hf.Instrument, tmp_path: Path) -> None:
    cube = np.random.default_rng(5).poisson(2.0, (3, ROWS, COLS, 128)).astype(np.uint16)
    cube[1] = 0
    write_sdt(tmp_path / "a.sdt", [cube], BIN_NS * 1e-9, kind=0x61, routed=3)
    with pytest.raises(FileFormatError, match=r"photons in channels \[0, 2\]: say which"):
        read_counts(tmp_path / "a.sdt", shot)
    for channel in (0, 2):
        found, _ = read_counts(tmp_path / "a.sdt", shot, channel=channel)
        np.testing.assert_array_equal(found, cube[channel])
    with pytest.raises(FileFormatError, match=r"no photons in channel 1; it has \[0, 2\]"):
        read_counts(tmp_path / "a.sdt", shot, channel=1)


def test_files_that_do_not_fit_the_instrument(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path
) -> None:
    path = tmp_path / "a.ptu"
    write_ptu(path, counts)

    def changed(**sensor: Any) -> hf.Instrument:
        return camera.replace(sensor=msgspec.structs.replace(camera.sensor, **sensor))

    with pytest.raises(InstrumentError, match="counts bins forward from 0"):
        read_counts(path, changed(direction="reverse"))
    with pytest.raises(InstrumentError, match=r"bins of 0\.4 ns, instrument 'scanner' of 0\.5 ns"):
        read_counts(path, changed(bin_width_ns=0.5))
    with pytest.raises(InstrumentError, match=r"\(5, 7\) pixels .* has \(5, 8\)"):
        read_counts(path, changed(cols=8))
    endless = msgspec.structs.replace(camera.timing, period_ns=None)
    short = msgspec.structs.replace(camera.sensor, code_bits=6)
    with pytest.raises(InstrumentError, match=r"photons up to bin 124, but sensor\.code_bits = 6"):
        read_counts(path, camera.replace(timing=endless, sensor=short))
    with pytest.raises(InstrumentError, match="does not say which bands"):
        read_counts(path)


@pytest.mark.parametrize("ending", ["ptu", "sdt"])
def test_damaged_files_are_named(
    counts: NDArray[Any], camera: hf.Instrument, tmp_path: Path, ending: str
) -> None:
    path = tmp_path / f"a.{ending}"
    if ending == "ptu":
        write_ptu(path, counts)
    else:
        write_sdt(path, [np.ones((ROWS, COLS, 128), np.uint16)], BIN_NS * 1e-9)
    whole = path.read_bytes()
    for keep in (0, 20, 120):
        path.write_bytes(whole[:keep])
        said = rf"is an empty file|can't be read as .* {ending.upper()} file"
        with pytest.raises(FileFormatError, match=said):
            read_counts(path, camera)
