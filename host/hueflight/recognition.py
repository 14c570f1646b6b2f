# SPDX-License-Identifier: Apache-2.0
"""What a file seems to be by its first bytes, for messages about files of the wrong kind."""

from __future__ import annotations

import json
from pathlib import Path

CALIBRATION_FORMAT = "hueflight calibration"  #: attribute `format` of the store of a calibration

NPY = "a NumPy array (.npy)"
NPZ = "a ZIP archive (.npz)"
HDF5 = "an HDF5 file (.h5, .nc)"
ZARR = "a Zarr store"
IMAGE = "an image"
CALIBRATION = "a calibration"
PTU = "a PicoQuant PTU file"
SDT = "a Becker & Hickl SDT file"  # which has no signature
MATLAB = "a MATLAB file"
TEXT = "a text file"
UNKNOWN = "a file of a kind that is not known here"
#: first bytes of files, and what such a file is called in a message
SIGNATURES = (
    (b"\x89MCAP", "an MCAP file"),
    (b"\x93NUMPY", NPY),
    (b"PK\x03\x04", NPZ),
    (b"\x89HDF\r\n\x1a\n", HDF5),
    (b"\x89PNG", "a picture (PNG)"),
    (b"\xff\xd8\xff", "a picture (JPEG)"),
    (b"II*\x00", "a TIFF file"),
    (b"MM\x00*", "a TIFF file"),
    (b"II+\x00", "a TIFF file"),
    (b"PQTTTR", PTU),
    (b"MATLAB", MATLAB),
    (b"LASF", "a point cloud (LAS)"),
    (b"ply\n", "a point cloud (PLY)"),
    (b"ENVI", "the header of an ENVI file"),
    (b"<!doctype html", "a web page"),
    (b"<!DOCTYPE html", "a web page"),
    (b"%PDF", "a PDF document"),
    (b"\x1f\x8b", "a compressed file (gzip)"),
)
#: what a file should be by its extension; the first is what it is called in a message
EXPECTED = {
    ".npy": (NPY,),
    ".npz": (NPZ,),
    ".zarr": (ZARR, IMAGE, CALIBRATION),
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".nc", ".nc4"), (HDF5,)),
    ".mat": (MATLAB, HDF5),  # version 7.3 is HDF5, which other programs write without its header
    ".ptu": (PTU,),
    ".sdt": (SDT,),
    **dict.fromkeys((".csv", ".json", ".jsonl", ".toml"), (TEXT,)),
}
BEGIN_BYTES = 4096


def what_is(path: Path, /) -> str:
    """Say what a file or folder seems to be.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file or folder, which need not exist.

    Returns
    -------
    str
        A noun with its article, such as ``"a calibration"`` or ``"a NumPy array (.npy)"``.
    """
    try:
        if path.is_dir():
            return _folder(path)
        with path.open("rb") as file:
            begin = file.read(BEGIN_BYTES)
    except OSError as error:
        return f"a file that can't be read ({error.strerror or error})"
    if not begin:
        return "an empty file"
    for signature, name in SIGNATURES:
        if begin.startswith(signature):
            return name
    try:
        text = begin.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start < len(begin) - 4:  # not a character that was cut in two
            return UNKNOWN
        text = begin[: error.start].decode("utf-8-sig")
    if not text.isprintable() and any(ord(c) < 32 and c not in "\t\r\n\f" for c in text):
        return UNKNOWN
    if "[sensor]" in text or "[[bands]]" in text:
        return "the description of an instrument"
    return TEXT


def reason_of(error: Exception) -> str:
    """Return the first line of an error, or its type where it says nothing.

    Parameters
    ----------
    error : Exception
        Error of a library.

    Returns
    -------
    str
        One line.
    """
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def why_unreadable(path: Path, error: Exception, /) -> str:
    """Say why a library could not read a file: it is something else, or it is damaged.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file, whose extension says what it should be.
    error : Exception
        What the library raised.

    Returns
    -------
    str
        One sentence.
    """
    seems = what_is(path)
    expected = EXPECTED.get(path.suffix.lower(), (seems,))
    if seems not in (*expected, UNKNOWN):
        return f"{str(path)!r} is {seems}, not {expected[0]}: give another file, or rename this one"
    meant = seems if seems in expected else expected[0]
    reason = reason_of(error).rstrip(".")
    return f"{str(path)!r} can't be read as {meant}: it is damaged or was cut short ({reason})"


def _folder(path: Path) -> str:
    attributes = _attributes(path)
    if attributes is None:
        return "a folder"
    if attributes.get("format") == CALIBRATION_FORMAT:
        return CALIBRATION
    if (path / "depth").is_dir() and (path / "wavelength").is_dir():
        return IMAGE
    return ZARR


def _attributes(path: Path) -> dict[str, object] | None:
    """Attributes of a Zarr store of format 2 or 3; None if the folder is none."""
    for name in ("zarr.json", ".zattrs", ".zgroup", ".zarray"):
        if (path / name).is_file():
            try:
                found = json.loads((path / name).read_text("utf-8"))
            except (OSError, ValueError):
                return {}
            return dict(found.get("attributes", {}) if name == "zarr.json" else found)
    return None
