# SPDX-License-Identifier: Apache-2.0
"""One capture file to one image store, with a summary of what was found."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.arguments import PATH, SWITCH, Kind, takes
from hueflight.calibration import Calibration
from hueflight.errors import HistogramError, HueflightError
from hueflight.export.description import describe
from hueflight.export.formats import FORMATS
from hueflight.export.stores import write_netcdf, write_zarr
from hueflight.files import import_optional, refuse_existing, staged
from hueflight.importers.captures import read_capture
from hueflight.importers.options import ReadOptions
from hueflight.progress import Progress, Silent, task
from hueflight.reconstruction.departures import correct_drift, with_floor
from hueflight.reconstruction.entry_point import reconstruct
from hueflight.reconstruction.image import EXPOSURES_KNOWN
from hueflight.reconstruction.image_check import ImageCheck, check_image
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.sums.recorded import reconstruct_recorded_sums
from hueflight.recording import RecordedSums, holds_recorded_sums, open_recording, read_sums

Departures = Literal["ignore", "check", "correct"]
SUMS_OPTIONS = frozenset({"range_correction", "pileup_correction", "region"})


@dataclass(frozen=True)
class FileResult:
    """What `reconstruct_file` made of a capture.

    Attributes
    ----------
    image : Dataset
        The image as it was written, in memory.
    store : Path
        Zarr store or NetCDF file that holds it.
    losses : mapping of str to int
        Number of packets or frames that the capture lacks, by reason; empty if it is complete.
    preview : Path or None
        Picture that was written beside it, if any.
    check : ImageCheck or None
        Check of the whole picture, before any correction, if it was asked for.
    """

    image: xr.Dataset
    store: Path
    losses: Mapping[str, int]
    preview: Path | None = None
    check: ImageCheck | None = None

    def summary(self) -> dict[str, Any]:
        """Summarise image and losses in plain values.

        Returns
        -------
        dict
            As `summarize` gives, with ``lost_…`` for each kind of loss, ``preview`` if a picture
            was written, and ``departures`` with one ``departure_…`` for each that a check found.
        """
        summary = summarize(self.image)
        summary |= {f"lost_{reason}": count for reason, count in self.losses.items()}
        if self.preview is not None:
            summary["preview"] = str(self.preview)
        if self.check is not None:
            summary["departures"] = len(self.check.found)
            for suspect in self.check.found:
                summary[f"departure_{suspect.name.replace(' ', '_')}"] = suspect.describe()
            if "drift_corrected" in self.image.attrs:
                summary["drift_corrected"] = self.image.attrs["drift_corrected"]
        return summary


#: what `calibration` may be
CALIBRATION_OR_PATH = Kind(
    "a Calibration or the path of one",
    lambda value: isinstance(value, Calibration) or PATH.accepts(value),
)


@takes(
    capture=PATH,
    out=PATH,
    calibration=CALIBRATION_OR_PATH,
    options=Mapping,
    preview=SWITCH,
    overwrite=SWITCH,
)
def reconstruct_file(
    capture: str | Path,
    out: str | Path,
    /,
    *,
    calibration: Calibration | str | Path,
    options: Mapping[str, Any] | None = None,
    reading: ReadOptions | None = None,
    departures: Departures = "ignore",
    preview: bool = False,
    overwrite: bool = False,
    attributes: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> FileResult:
    """Reconstruct one capture file into a Zarr store or a NetCDF file.

    Parameters
    ----------
    capture : str or Path
        Recording (``.mcap``) or counts (``.npz``, ``.npy``, ``.zarr``, ``.h5``, ``.ptu``,
        ``.sdt``).
    out : str or Path
        Store to write, ``NAME.zarr``, or a NetCDF file, ``NAME.nc``.
    calibration : Calibration, str or Path
        Calibration of the same instrument, or the path of one.
    options : mapping, optional
        Keywords of `reconstruct`, such as ``{"method": "pooled"}``.
    reading : ReadOptions, optional
        What to take from a file of counts.
    departures : {"ignore", "check", "correct"}
        Whether to check the whole picture for departures from its calibration. ``"check"`` states
        them in the image and widens its deviations by what tails and flare are predicted to leave;
        ``"correct"`` also reconstructs the image once more, with delays and widths of the LEDs and
        the shape of the background corrected.
    preview : bool, default False
        Whether to write a picture ``NAME.png`` beside the store.
    overwrite : bool, default False
        Whether an existing store and picture may be replaced.
    attributes : mapping of str to str, optional
        Further attributes of the image.
    progress : Progress, optional
        Told about each step.

    Returns
    -------
    FileResult
        The image, where it is, and what the capture lacks.

    Raises
    ------
    OutputExistsError
        If `out` or the picture exists and may not be replaced, which is checked before anything
        is read.
    OutputError
        If the disk does not take them.
    HueflightError
        If capture or calibration can't be read, or they do not fit one another.
    """
    capture, out = Path(capture), Path(out)
    picture = out.with_suffix(".png") if preview else None
    refuse_existing(out, overwrite=overwrite)
    if picture is not None:
        refuse_existing(picture, overwrite=overwrite)
        import_optional("matplotlib", extra="report")
    netcdf = out.name.lower().endswith(FORMATS["netcdf"].endings)
    if netcdf:
        import_optional("h5netcdf", extra="export")
    shown = progress or Silent()
    with task(shown, "reading", 2):
        if not isinstance(calibration, Calibration):
            calibration = Calibration.load(calibration)
        shown.advance()
        sums = _sums_of(capture, calibration)
        if sums is None:
            taken = read_capture(
                capture, calibration.instrument, **asdict(reading or ReadOptions())
            )
            losses = taken.losses
        else:
            taken, losses = None, sums.losses
        shown.advance()
    with task(shown, "reconstructing", 1):
        check = None
        if sums is not None:
            image = _image_of_sums(sums, calibration, options or {}, departures)
        else:
            assert taken is not None
            image = reconstruct(taken.counts, calibration, **(options or {}))
        if taken is not None and departures != "ignore":
            image, calibration, check = _checked(
                image, taken.counts, calibration, options or {}, correct=departures == "correct"
            )
        shown.advance()
    lost = ", ".join(f"{reason} {count}" for reason, count in losses.items())
    image = describe(
        image,
        calibration,
        capture=capture.name,
        capture_losses=lost or "none",
        **(attributes or {}),
    )
    (write_netcdf if netcdf else write_zarr)(image, out, overwrite=overwrite)
    if picture is not None:
        _write_picture(image, calibration, picture, overwrite=overwrite)
    return FileResult(image, out, losses, picture, check)


def _sums_of(capture: Path, calibration: Calibration) -> RecordedSums | None:
    """Totals of a recording of sums; None for any other capture."""
    if capture.suffix.lower() != ".mcap":
        return None
    with open_recording(capture) as recording:
        if recording.frames or not holds_recorded_sums(recording):
            return None
        if apart := recording.instrument.differences(calibration.instrument):
            raise HistogramError(
                f"{capture} was recorded by instrument {recording.instrument.name!r}, not "
                f"{calibration.instrument.name!r}: {'; '.join(apart[:3])}"
            )
        return read_sums(recording)


def _image_of_sums(
    sums: RecordedSums, calibration: Calibration, options: Mapping[str, Any], departures: Departures
) -> xr.Dataset:
    """Image of recorded sums, with those options that sums leave."""
    method = options.get("method", "sums")
    if method != "sums" or departures != "ignore":
        wanted = f"method {method!r}" if method != "sums" else "a check of the picture"
        raise HueflightError(
            f"the recording holds sums, not codes: {wanted} needs histograms; use method 'sums', "
            "or record codes"
        )
    useless = set(options) - SUMS_OPTIONS - {"method", "threads"}
    if useless:
        raise HueflightError(
            f"the recording holds sums, not codes: {', '.join(sorted(useless))} can't be given; "
            f"there are {', '.join(sorted(SUMS_OPTIONS))}"
        )
    given = {name: value for name, value in options.items() if name in SUMS_OPTIONS}
    return reconstruct_recorded_sums(sums, calibration, **given)


def _checked(
    image: xr.Dataset,
    counts: NDArray[np.generic],
    calibration: Calibration,
    options: Mapping[str, Any],
    *,
    correct: bool,
) -> tuple[xr.Dataset, Calibration, ImageCheck]:
    """Image that states its departures, corrected if that is asked for, and its calibration."""
    if correct and options.get("method", "joint") != "joint":
        raise HueflightError(
            f"method {options['method']!r} does not profit from corrected waveforms: correct the "
            "drift with method 'joint', or only check the image"
        )
    names = ("depth_range", "frames", "pileup_correction", "threads")
    given = {name: options[name] for name in names if name in options}
    if correct:
        correction = correct_drift(counts, calibration, image, **given)
        before, after = correction.before, correction.after
        calibration = correction.calibration
        changed = {**options, "background": correction.background}
        image = reconstruct(counts, calibration, **changed)
        drift = calibration.provenance.get("drift")
        image.attrs["drift_corrected"] = "none" if drift is None else json.dumps(drift)
    else:
        before = after = check_image(counts, calibration, image, **given)
    image = with_floor(image, counts, calibration, after, **given)
    image.attrs["image_check"] = json.dumps(before.to_json())
    return image, calibration, before


def summarize(image: xr.Dataset) -> dict[str, Any]:
    """Summarise an image in plain values.

    Parameters
    ----------
    image : Dataset
        As `reconstruct` gives.

    Returns
    -------
    dict
        Method, number of pixels and of those with depth, percentiles of depth and the median of
        its standard deviation (m), the number of pixels with each flag of quality that occurs,
        and ``exposures`` where their number is not known.
    """
    depth, quality = image["depth"].values, image["quality"].values
    known = np.isfinite(depth)
    summary: dict[str, Any] = {
        "method": image.attrs["method"],
        "pixels": int(depth.size),
        "pixels_with_depth": int(known.sum()),
    }
    if known.any():
        for percent in (5, 50, 95):
            summary[f"depth_{percent}_percent_m"] = float(np.percentile(depth[known], percent))
        summary["median_depth_std_m"] = float(np.nanmedian(image["depth_std"].values))
    for flag in Quality:
        if count := int(((quality & int(flag)) != 0).sum()):
            summary[f"{(flag.name or '').lower()}_pixels"] = count
    exposures = image.attrs.get("exposures", EXPOSURES_KNOWN)
    if exposures != EXPOSURES_KNOWN:
        summary["exposures"] = exposures
    return summary


def _write_picture(
    image: xr.Dataset, calibration: Calibration, path: Path, *, overwrite: bool
) -> None:
    from hueflight.report.preview import draw_preview  # needs an extra

    with staged(path, overwrite=overwrite) as partial:
        draw_preview(image, calibration.instrument).savefig(partial)
