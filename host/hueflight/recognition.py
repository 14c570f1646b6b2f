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


def why_unreadable(path: Path, meant: str, error: Exception, /) -> str:
    """Say why a library could not read a file: it is something else, or it is damaged.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file.
    meant : str
        What the file should be, such as `NPY`.
    error : Exception
        What the library raised.

    Returns
    -------
    str
        One sentence.
    """
    seems = what_is(path)
    if seems not in (meant, UNKNOWN):
        return f"{str(path)!r} is {seems}, not {meant}: give another file, or rename this one"
    reason = str(error).splitlines()[0].rstrip(".") if str(error) else type(error).__name__
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
