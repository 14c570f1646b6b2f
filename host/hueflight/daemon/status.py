# SPDX-License-Identifier: Apache-2.0
"""The daemon's state as plain dictionaries, for the API, the live page and metrics."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from hueflight.acquisition.plan import Gap
from hueflight.acquisition.snapshot import Snapshot
from hueflight.daemon.calibration_job import CalibrationJob
from hueflight.daemon.picture import Picture
from hueflight.daemon.pictures import Pictures
from hueflight.daemon.recording_job import RecordingJob
from hueflight.devices.camera_controls import MIN_RATE_HZ, CameraControls, CameraTiming
from hueflight.devices.illumination import GUIDANCE
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.entry_point import METHODS
from hueflight.reconstruction.quality import Quality


def run_status(snapshot: Snapshot, /) -> dict[str, Any]:
    """Return progress of the present run, totals since the start, losses, link and gaps."""
    return {
        "simulated": snapshot.simulated,
        "camera": snapshot.rig,
        "kind": snapshot.kind,
        "run": {
            "frames": snapshot.run_frames,
            "limit": snapshot.run_limit,
            "photons": snapshot.run_photons,
        },
        "totals": {
            "exposed": snapshot.totals.exposed,
            "delivered": snapshot.totals.delivered,
            "photons": snapshot.photons,
            "bytes": snapshot.received_bytes,
        },
        "lost": snapshot.totals.losses.as_dict(),
        "link": {
            "queue_bytes": snapshot.stream.queued_bytes,
            "stalls": snapshot.stream.stalls,
            "stalled_s": snapshot.stream.stalled_s,
            "errors": snapshot.stream.link_errors,
            "connections": snapshot.connections,
        },
        "gaps": [_gap(gap) for gap in snapshot.gaps[-10:]],
    }


def _gap(gap: Gap) -> dict[str, Any]:
    return {
        "started": gap.started,
        "seconds": gap.seconds,
        "reason": gap.reason,
        "frames_lost": gap.frames_lost,
    }


def picture_status(pictures: Pictures, /, *, now_s: float, stale_after_s: float) -> dict[str, Any]:
    """Return number and age of the latest picture, and how pictures are made."""
    picture = pictures.latest
    age_s = None if picture is None else now_s - picture.received_s
    return {
        "number": picture.number if picture else 0,
        "age_s": age_s,
        "stale": age_s is None or age_s > stale_after_s,
        "stale_after_s": stale_after_s,
        "skipped": pictures.skipped,
        "method": pictures.settings.method,
        "methods": list(METHODS),
        "integration_s": pictures.settings.integration_s,  # infinity becomes null in JSON
        "frames": _spread_of_frames(picture),
    }


def _spread_of_frames(picture: Picture | None) -> dict[str, int]:
    """Frames behind the pixels of a picture: of the fewest, of half of them, and the most."""
    if picture is None:
        return {"least": 0, "median": 0, "most": 0}
    frames = picture.frames_by_pixel
    return {
        "least": int(frames.min()),
        "median": int(np.median(frames)),
        "most": picture.frames,
    }


def calibration_status(job: CalibrationJob, /, *, calibrated: bool) -> dict[str, Any]:
    """Return progress of a calibration, and whether pictures are calibrated."""
    progress = job.progress()
    return {
        "step": job.state.step,
        "message": job.state.message,
        "path": job.state.path,
        "calibrated": calibrated,
        "progress": None if progress is None else asdict(progress),
    }


def recording_status(job: RecordingJob, snapshot: Snapshot, /) -> dict[str, Any]:
    """Return progress of the recording, and the summary of the last one."""
    return {
        "name": job.name,
        "frames": snapshot.recorded_frames,
        "bytes": snapshot.recorded_bytes,
        "queue_bytes": snapshot.recorder_queue_bytes,
        "failure": snapshot.recording_failure,
        "paused": snapshot.recording_paused,
        "last": job.last,
    }


def describe_controls(controls: CameraControls, /) -> dict[str, Any]:
    """Return what of the camera may be changed, as JSON holds it."""
    return asdict(controls) | {"leaves_out": controls.leaves_out}


def describe_limits(instrument: Instrument, timing: CameraTiming | None, /) -> dict[str, Any]:
    """Return the limits of the controls; the highest rate is None while no camera was there."""
    sensor = instrument.sensor
    most = None if timing is None else timing.max_rate_hz(instrument)
    return {
        "rate_hz": [MIN_RATE_HZ, most],
        "rows": [0, sensor.rows - 1],
        "cols": [0, sensor.cols - 1],
        "gate": [0, sensor.codes - 1],
    }


def describe_instrument(instrument: Instrument, /) -> dict[str, Any]:
    """Return the facts about the instrument that clients need to display its pictures."""
    right, down = instrument.ray_slopes()
    sensor = instrument.sensor
    return {
        "name": instrument.name,
        "description": instrument.description,
        "rows": instrument.image_shape[0],
        "cols": instrument.image_shape[1],
        "codes": sensor.codes,
        "frame_rate_hz": sensor.frame_rate_hz,
        "period_ns": instrument.timing.period_ns,
        "pixel_aspect": (sensor.pixel_height_um or 1) / (sensor.pixel_width_um or 1),
        "slope_right": float(right[0, -1]),
        "slope_down": float(down[-1, 0]),
        "fingerprint": instrument.fingerprint(),
        "bands": [
            {
                "name": band.name,
                "wavelength_nm": band.wavelength_nm,
                "fwhm_nm": band.emission_fwhm_nm,
            }
            for band in instrument.bands
        ],
        "flags": {flag.name.lower(): int(flag) for flag in Quality if flag.name},
        "guidance": GUIDANCE,
    }
