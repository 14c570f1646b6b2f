# SPDX-License-Identifier: Apache-2.0
"""The daemon's state as plain dictionaries, for the API, the live page and metrics."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from hueflight.acquisition.plan import Gap
from hueflight.acquisition.snapshot import Snapshot
from hueflight.daemon.calibration_job import CalibrationJob
from hueflight.daemon.pictures import Pictures
from hueflight.daemon.recording_job import RecordingJob
from hueflight.devices.camera_controls import MIN_RATE_HZ, CameraControls
from hueflight.devices.illumination import GUIDANCE
from hueflight.devices.pulse_schedule import Capacity
from hueflight.model.instrument import Instrument, Sensor
from hueflight.model.schedules import Schedule
from hueflight.reconstruction.entry_point import METHODS
from hueflight.reconstruction.quality import Quality
from hueflight_protocol.illuminator_map import MAX_PERIOD_TICKS

_NO_FRAMES = {"least": 0, "median": 0, "most": 0}


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
        "method": "sums" if pictures.reduced else pictures.settings.method,
        "methods": list(METHODS),
        # infinity becomes null in JSON
        "integration_s": pictures.settings.integration_s,
        "frames": _NO_FRAMES if picture is None else picture.spread_of_frames,
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
    """Return what of camera and LEDs may be changed, as JSON holds it."""
    described = asdict(replace(controls, reduction=None)) | {"leaves_out": controls.leaves_out}
    for name in ("reduction", "codes_rate_hz"):  # the daemon chooses these by itself
        del described[name]
    return described


def describe_limits(instrument: Instrument, snapshot: Snapshot, /) -> dict[str, Any]:
    """Return the limits of the controls; None where no board that has them was there."""
    sensor, timing, capacity = instrument.sensor, snapshot.timing, snapshot.capacity
    most = None if timing is None else timing.max_rate_hz(instrument)
    return {
        "rate_hz": [MIN_RATE_HZ, most],
        "rows": [0, sensor.rows - 1],
        "cols": [0, sensor.cols - 1],
        "gate": [0, sensor.codes - 1],
        "schedule": None if capacity is None else _limits_of_schedules(sensor, capacity),
    }


def _limits_of_schedules(sensor: Sensor, capacity: Capacity) -> dict[str, Any]:
    tick_ns = capacity.tick_ns
    codes = sensor.codes - sensor.reports_empty  # a period must fit into these
    longest = min(MAX_PERIOD_TICKS, int(codes * sensor.bin_width_ns / tick_ns))
    return {
        "tick_ns": tick_ns,
        "period_ns": [ticks * tick_ns for ticks in (capacity.min_period_ticks, longest)],
        "pulses": capacity.pulses,
    }


def stated_schedule(instrument: Instrument, /) -> dict[str, Any] | None:
    """Return the schedule that an instrument states; None if it has no period."""
    return None if instrument.timing.period_ns is None else asdict(Schedule.of(instrument))


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
