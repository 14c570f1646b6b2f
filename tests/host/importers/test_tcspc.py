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


def write_sdt(path: Path, blocks: list[NDArray[np.uint16]], bin_width_s: float) -> None:
    """A minimal "SPC Setup & Data File", after SPC_data_file_structure.h of Becker & Hickl.

    Byte layout: file header, information text, one measurement description (its first part,
    up to the scan sizes), then data blocks with their headers.
    """
    rows, cols, bins = blocks[0].shape
    info = b"*IDENTIFICATION\r\n  ID        : SPC Setup & Data File\r\n*END\r\n\r\n"
    measure = b"".join((
        struct.pack("<9s11s16sh", b"12:00:00", b"2024-01-01", b"3D0001", 9),
        struct.pack("<4f", 0, 0, 0, 0),  # cfd
        struct.pack("<fhf", 0, 1, 0),  # syn
        struct.pack("<fh3f", bin_width_s * bins, 1, 0, 0, 0),  # tac_r, tac_g, …
        struct.pack("<hhhhHff", bins, 0, 1, 1, 1, 1.0, 1.0),  # adc_re, …
        struct.pack("<hBhHfhhh16sf", 0, 0, 0, 0, 0, 0, 0, 0, b"SPC-150", 0),
        struct.pack("<6h4if2h", 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
        struct.pack("<4i", cols, rows, 1, 1),  # scan_x, scan_y, scan_rx, scan_ry
    ))  # fmt: skip
    header_size, block_size = 42, 22
    info_at = header_size
    measure_at = info_at + len(info)
    data_at = measure_at + len(measure)
    revision = (0x28 << 4) | 15  # SPC-150
    header = struct.pack(
        "<hihiHihIihhHIHH", revision, info_at, len(info), 0, 0, data_at, len(blocks),
        blocks[0].nbytes, measure_at, 1, len(measure), 0x5555, 0, 0, 0x55AA,
    )  # fmt: skip
    assert len(header) == header_size
    content, offset = [header, info, measure], data_at
    for number, block in enumerate(blocks):
        following = offset + block_size + block.nbytes
        content.append(
            struct.pack(
                "<BBIIHhII", 0, 0, offset + block_size, following, 0x01, 0, number, block.nbytes
            )
        )
        content.append(block.astype("<u2").tobytes())
        offset = following
    path.write_bytes(b"".join(content))


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
    with pytest.raises(FileFormatError, match="holds 2 data blocks"):
        read_counts(tmp_path / "a.sdt", shot)
    with pytest.raises(FileFormatError, match="no data block '2': there are 0 to 1"):
        read_counts(tmp_path / "a.sdt", shot, dataset="2")


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
