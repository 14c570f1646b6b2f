# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight info`."""

from __future__ import annotations

from pathlib import Path

from hueflight.cli.exit_codes import DATA_LOST
from hueflight.cli.output import show
from hueflight.files.inspection import FileDescription


def info(file: Path, *, check: bool = False, json: bool = False) -> int:
    """Show what a file is, what it holds and whether it is whole.

    Without --check, only the description in the file is read, and the result says that the
    contents were not checked. The exit code is 3 if something is missing or damaged.

    Parameters
    ----------
    file : Path
        Recording (.mcap), counts (.npz, .npy, .zarr, .h5, .mat, .csv, .json, .ptu, .sdt),
        calibration (.zarr), image (.zarr, .nc) or instrument description (.toml).
    check : bool, default False
        Read everything, compare it with the checksums in the file and say whether it is whole.
    json : bool, default False
        Print one JSON object instead of a table.

    Returns
    -------
    int
        Exit code.
    """
    found = _describe(file, check)
    facts = found.as_dict()
    if not json:
        del facts["whole"], facts["evidence"]
        state = {True: "whole", False: "damaged or incomplete", None: "not checked"}[found.whole]
        facts["contents"] = f"{state}: {found.evidence}"
        if "report" in facts:
            # people want what is not as it should be, not thirty zeros
            facts["report"] = {name: count for name, count in facts["report"].items() if count}
    show(f"{found.kind[0].upper()}{found.kind[1:]} {file}", facts, json_wanted=json)
    return DATA_LOST if found.whole is False else 0


def _describe(file: Path, check: bool) -> FileDescription:
    if file.suffix.lower() == ".mcap":
        from hueflight.recording.inspection import describe_recording

        return describe_recording(file, check=check)
    from hueflight.importers.inspection import describe_file  # loads what recordings don't need

    return describe_file(file, check=check)
