# SPDX-License-Identifier: Apache-2.0
"""MATLAB, Photon-HDF5, CSV and module logs, written by other libraries or by hand."""

import json

import numpy as np
import pytest

from hueflight.errors import FileFormatError, InstrumentError
from hueflight.importers import read_counts
from hueflight.model.instrument import Band, Instrument, Sensor

ROWS, COLS, CODES = 2, 3, 8


def camera(rows=ROWS, cols=COLS) -> Instrument:
    return Instrument(
        name="x", sensor=Sensor(rows=rows, cols=cols, code_bits=3, bin_width_ns=0.5),
        bands=(Band(name="red", wavelength_nm=640),),
    )  # fmt: skip


@pytest.fixture
def counts():
    return np.random.default_rng(0).integers(1, 100, (ROWS, COLS, CODES)).astype(np.uint16)


def test_matlab_version_5(tmp_path, counts):
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"hist": counts, "bin_width": 0.5, "note": "no numbers"})
    np.testing.assert_array_equal(read_counts(tmp_path / "a.mat", camera())[0], counts)
    savemat(tmp_path / "b.mat", {"hist": counts.transpose(2, 0, 1), "other": counts})
    found, _ = read_counts(tmp_path / "b.mat", camera(), dataset="hist", axes="code,row,col")
    np.testing.assert_array_equal(found, counts)
    with pytest.raises(FileFormatError, match="hist, other"):
        read_counts(tmp_path / "b.mat", camera())
    (tmp_path / "c.mat").write_bytes((tmp_path / "b.mat").read_bytes()[:300])
    with pytest.raises(FileFormatError, match="MATLAB"):
        read_counts(tmp_path / "c.mat", camera(), dataset="hist")


def test_matlab_version_7_3(tmp_path, counts):
    """MATLAB writes the axes in reverse and 512 bytes of its own before the HDF5 file."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["hist"] = counts.T
        file["bin_width"] = np.array([[0.5]])
        file.create_group("#refs#")
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file")
    np.testing.assert_array_equal(read_counts(tmp_path / "a.mat", camera())[0], counts)


def test_photon_hdf5(tmp_path):
    h5py = pytest.importorskip("h5py")
    times = np.array([3, 3, 5, 7, 0], np.uint16)
    with h5py.File(tmp_path / "p.h5", "w") as file:
        file["photon_data/timestamps"] = np.arange(5)
        file["photon_data/nanotimes"] = times
        file["photon_data/detectors"] = np.array([0, 0, 1, 0, 1], np.uint8)
        file["photon_data/nanotimes_specs/tcspc_unit"] = 0.5e-9
    point = camera(1, 1)
    found, _ = read_counts(tmp_path / "p.h5", point, channel=0)
    np.testing.assert_array_equal(found[0, 0], [0, 0, 0, 2, 0, 0, 0, 1])
    with pytest.raises(FileFormatError, match="detectors 0, 1: say which"):
        read_counts(tmp_path / "p.h5", point)
    with pytest.raises(FileFormatError, match="no photons of detector 4"):
        read_counts(tmp_path / "p.h5", point, channel=4)
    with pytest.raises(InstrumentError, match="photons of a point"):
        read_counts(tmp_path / "p.h5", camera(), channel=0)
    with h5py.File(tmp_path / "p.h5", "r+") as file:
        file["photon_data/nanotimes_specs/tcspc_unit"][()] = 1e-9
    with pytest.raises(InstrumentError, match="bins of 1 ns"):
        read_counts(tmp_path / "p.h5", point, channel=0)


@pytest.mark.parametrize("mark", [",", ";", "\t", " "])
def test_a_table_with_a_line_for_each_pixel(tmp_path, counts, mark):
    lines = [mark.join(map(str, line)) for line in counts.reshape(-1, CODES)]
    titles = mark.join(f"bin{n}" for n in range(CODES))
    for head in ([], ["# made by hand"], [titles]):
        (tmp_path / "t.csv").write_text("\n".join(head + lines) + "\n")
        found, _ = read_counts(tmp_path / "t.csv", camera())
        np.testing.assert_array_equal(found, counts)
        assert found.dtype == np.uint32


def test_a_table_that_numbers_its_pixels(tmp_path, counts):
    lines = ["row,col," + ",".join(map(str, range(CODES)))]
    lines += [f"{r},{c}," + ",".join(map(str, counts[r, c])) for c in (2, 0) for r in (1, 0)]
    (tmp_path / "t.csv").write_text("\n".join(lines))
    found, _ = read_counts(tmp_path / "t.csv", camera())
    np.testing.assert_array_equal(found[:, [0, 2]], counts[:, [0, 2]])
    assert not found[:, 1].any()
    (tmp_path / "t.csv").write_text("\n".join([*lines, lines[-1]]))
    with pytest.raises(FileFormatError, match="more than one line"):
        read_counts(tmp_path / "t.csv", camera())
    (tmp_path / "t.csv").write_text(lines[0] + "\n5" + lines[1][1:])
    with pytest.raises(FileFormatError, match="counted from 0"):
        read_counts(tmp_path / "t.csv", camera())


def test_a_single_pixel_as_a_column(tmp_path, counts):
    column = "\n".join(f"{n * 0.5}, {value}" for n, value in enumerate(counts[0, 0]))
    (tmp_path / "one.csv").write_text("time,counts\n" + column)
    found, _ = read_counts(tmp_path / "one.csv", camera(1, 1))
    np.testing.assert_array_equal(found[0, 0], counts[0, 0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no lines"), ("1,2\n3", "from 1 to 2 columns"), ("1,2\n3,x", "more than numbers"),
        ("1,2\n3,4", r"shape \(2, 2\).* need 6"),
    ],
)  # fmt: skip
def test_what_is_no_table_is_refused(tmp_path, text, message):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_counts(tmp_path / "t.csv", camera())


def test_logs_of_modules(tmp_path, counts):
    zones = counts.reshape(-1, CODES).tolist()
    pulse = list(range(CODES))
    captures = [{"hists": zones, "reference_hist": pulse}, {"histograms": zones}]
    (tmp_path / "log.json").write_text(json.dumps(captures))
    found, _ = read_counts(tmp_path / "log.json", camera(), dataset="1")
    np.testing.assert_array_equal(found, counts)
    found, _ = read_counts(tmp_path / "log.json", camera(), dataset="sum")
    np.testing.assert_array_equal(found, 2 * counts.astype(int))
    found, _ = read_counts(tmp_path / "log.json", camera(), dataset="0:reference")
    assert (found == pulse).all()
    with pytest.raises(FileFormatError, match="2 captures: say which"):
        read_counts(tmp_path / "log.json", camera())
    for wrong in ("2", "-1", "x", "0:what"):
        with pytest.raises(FileFormatError, match="number from 0 to 1"):
            read_counts(tmp_path / "log.json", camera(), dataset=wrong)
    with pytest.raises(FileFormatError, match="no reference_hist; it has histograms"):
        read_counts(tmp_path / "log.json", camera(), dataset="1:reference")
    with pytest.raises(FileFormatError, match="need 1"):
        read_counts(tmp_path / "log.json", camera(1, 1), dataset="0")
    (tmp_path / "lines.jsonl").write_text("\n".join(map(json.dumps, captures)))
    found, _ = read_counts(tmp_path / "lines.jsonl", camera(), dataset="1")
    np.testing.assert_array_equal(found, counts)
    for text in ("{", "[]", "[1]", '{"hists": [["a"]]}'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(FileFormatError, match=r"JSON|no log|not lists"):
            read_counts(tmp_path / "bad.json", camera())


def test_a_real_log(real_data):
    log = real_data / "tmf8820" / "plane_distances.json"
    module = Instrument(
        name="tmf8820", sensor=Sensor(rows=3, cols=3, code_bits=7, bin_width_ns=0.1),
        bands=(Band(name="infrared", wavelength_nm=940),),
    )  # fmt: skip
    found, _ = read_counts(log, module, dataset="12")
    capture = json.loads(log.read_text())[12]
    np.testing.assert_array_equal(found.reshape(9, -1), capture["hists"])
