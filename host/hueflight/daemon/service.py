# SPDX-License-Identifier: Apache-2.0
"""The daemon without HTTP: acquisition, pictures, recordings and calibrations of one camera."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import structlog

from hueflight.acquisition.plan import CaptureError, RunPlan
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.snapshot import Snapshot
from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.calibration import Calibration
from hueflight.color.live_color import LiveColor
from hueflight.daemon.calibration_job import CalibrationJob
from hueflight.daemon.cameras import Cameras
from hueflight.daemon.check_job import CheckJob
from hueflight.daemon.codes_choice import CodesChoice
from hueflight.daemon.config import DaemonConfig
from hueflight.daemon.disk_watch import DiskWatch
from hueflight.daemon.finisher import Finisher
from hueflight.daemon.latency import LatencyMeter
from hueflight.daemon.materials import PictureMaterials
from hueflight.daemon.picture import Picture
from hueflight.daemon.pictures import Pictures
from hueflight.daemon.playback import Playback
from hueflight.daemon.rate_meter import RateMeter
from hueflight.daemon.recording_job import RecordingJob
from hueflight.daemon.recording_pictures import RecordingPictures
from hueflight.daemon.recordings_folder import RecordingsFolder
from hueflight.daemon.results_folder import ResultsFolder
from hueflight.daemon.simulated_part import SimulatedPart
from hueflight.daemon.status import (
    calibration_status,
    describe_controls,
    describe_instrument,
    describe_limits,
    picture_status,
    recording_status,
    run_status,
    stated_schedule,
)
from hueflight.daemon.stream_settings import run_settings
from hueflight.devices.rig import Connect
from hueflight.live.protocol import PROTOCOL
from hueflight.model.instrument import Instrument

log = structlog.get_logger("hueflight.daemon")
STALE_S = 2.0  #: a picture older than this, and than three intervals, is stale
LIVE = RunPlan(live=True)
SUMS_SENT = (
    'the camera sends sums; write sends = "codes" in the configuration, or lower the frame rate to '
    "what the link carries"
)


class Service:
    """One camera's daemon.

    Parameters
    ----------
    config : DaemonConfig
        Configuration.
    connect : callable
        Opens the rig; see `hueflight.devices.rig.Connect`.
    instrument : Instrument
        Instrument that the camera belongs to.
    on_picture : callable
        Called with each picture, in another thread.

    Attributes
    ----------
    stated, instrument : Instrument
        The instrument as it is configured, and with the schedule that its LEDs have at present.
    acquisition : Acquisition
        Runs the camera.
    pictures : Pictures
        Reconstructs live pictures.
    recording_job : RecordingJob
        Begins and ends recordings.
    calibration_job : CalibrationJob
        Takes and uses calibrations.
    check_job : CheckJob
        Checks and corrects the calibration in use.
    folder : RecordingsFolder
        Folder of the recordings.
    disk : DiskWatch
        Knows whether that folder is there and has room.
    finisher : Finisher
        Finishes recordings that were cut off.
    results : ResultsFolder
        Folder of images and counts that the page shows.
    cameras : Cameras
        The other daemons that the configuration names.
    playback : Playback
        Makes pictures of recordings and results.
    simulated_part : SimulatedPart
        Calibrates a simulated camera, unplugs it, and changes what it sees.
    live_color : LiveColor
        Colours of live pictures.
    codes_choice : CodesChoice
        Has the camera send codes or sums.
    materials : PictureMaterials
        Abundances and indices of live pictures.
    latencies : LatencyMeter
        Times from last photon to display.
    viewers : int
        Viewers of the live picture at present.
    """

    def __init__(
        self,
        config: DaemonConfig,
        connect: Connect,
        instrument: Instrument,
        /,
        *,
        on_picture: Callable[[Picture], None],
    ) -> None:
        self.config, self.stated = config, instrument
        self.instrument, self._fingerprint = instrument, instrument.fingerprint()
        self._using = threading.RLock()  # so that no calibration is used of an earlier schedule
        self.folder = RecordingsFolder(config.folder / "recordings")
        self.disk = DiskWatch(self.folder.root)
        pictures_in_recordings = RecordingPictures(
            config.recording.foxglove_hz, calibration=lambda: self.pictures.calibration
        )
        self.finisher = Finisher(self.folder, on_finished=pictures_in_recordings.add)
        self._events: Counter[str] = Counter()
        self.rates = RateMeter()
        self.latencies = LatencyMeter()
        self.live_color = LiveColor(instrument)
        self.materials = PictureMaterials(config.materials, instrument)
        self.viewers = 0
        self._started_s = time.monotonic()
        self.settings = run_settings(config, instrument)
        self.pictures = Pictures(
            instrument,
            method=config.method,
            integration_s=config.integration_or_default,
            window_blocks=self.settings.window_blocks,
            rate_hz=self.settings.rate_hz,
            block_frames=self.settings.block_frames,
            change_sigma=config.change_sigma,
            threads=config.picture_threads or os.cpu_count() or 1,
            on_picture=on_picture,
            is_watched=lambda: self.viewers > 0,
        )
        self.acquisition = Acquisition(
            connect,
            instrument,
            settings=self.settings,
            live=LIVE,
            on_block=self.pictures.offer,
            on_event=self._note,
        )
        self.recording_job = RecordingJob(
            self.acquisition,
            self.folder,
            daemon_name=config.name,
            calibration=lambda: self.pictures.calibration,
            calibration_name=lambda: self.calibration_job.name,
            controls=lambda: describe_controls(self.acquisition.controls),
            on_ended=self.finisher.finish,
            check_free=lambda: self._check_captures_idle(),
        )
        folder = config.folder / "calibrations"
        self.calibration_job = CalibrationJob(
            self.acquisition,
            folder,
            use=self._use,
            check_free=self._check_free_for_calibration,
        )
        self.check_job = CheckJob(
            self.acquisition,
            folder,
            calibration=lambda: self.pictures.calibration,
            use=self.calibration_job.use_corrected,
            check_free=self._check_free_for_check,
        )
        self.calibration_job.load_latest(instrument)
        self.results = ResultsFolder(config.folder / "results")
        self.playback = Playback(
            self.folder,
            self.results,
            config.folder / "calibrations",
            instrument,
            calibration=lambda: self.pictures.calibration,
            method=lambda: self.pictures.settings.method,
        )
        self.codes_choice = CodesChoice(
            self.acquisition,
            config.sends,
            calibration=lambda: self.pictures.calibration,
            settings=lambda: self.settings,
            lock=self._using,
        )
        self.cameras = Cameras(config.cameras)
        self.simulated_part = SimulatedPart(
            self.acquisition, self.pictures, use=self.calibration_job.use_simulated
        )

    def _note(self, name: str, details: dict[str, Any]) -> None:
        """Called with each event of acquisition and recording, in their threads."""
        self._events[name] += 1
        failed = name.endswith(("failed", "paused"))
        (log.error if failed else log.info)(name, **details)

    def _use(self, calibration: Calibration) -> None:
        with self._using:
            calibration.require(self.instrument)
            self.live_color = LiveColor(self.instrument, calibration.emission)
            self.pictures.calibration = calibration

    def _check_captures_idle(self) -> None:
        self.calibration_job.check_idle()
        self.check_job.check_idle()

    def _check_free_for_calibration(self) -> None:
        self.recording_job.check_idle()
        self.check_job.check_idle()

    def _check_free_for_check(self) -> None:
        self.recording_job.check_idle()
        self.calibration_job.check_idle()

    def start(self) -> None:
        """Start the live run.

        Raises
        ------
        CaptureError
            If a calibration, or a check of it, is in progress.
        """
        self._check_captures_idle()
        self.acquisition.set_live(LIVE)

    def change_pictures(
        self,
        *,
        frames: int | None = None,
        integration_s: float | None = None,
        method: str | None = None,
    ) -> tuple[int, int]:
        """Make pictures in another way, of photons that come from now on.

        Parameters
        ----------
        frames : int, optional
            Frames behind each picture at least, changed or not; 0 for what the configuration says.
        integration_s : float, optional
            Longest time over which photons add up, in seconds; see `PictureSettings`.
        method : str, optional
            Method of reconstruction. What is not given stays as it is.

        Returns
        -------
        frames : int
            Frames that each picture has at least, once so many were taken.
        number : int
            Number of the latest picture that may hold older photons.

        Raises
        ------
        PictureSettingsError
            If the settings are not possible.
        """
        settings = self.pictures.settings
        self._check_sums_allow(method)
        if frames is not None:
            seconds = 0.0 if frames else self.config.integration_or_default
            settings = replace(settings, frames=frames, integration_s=seconds)
        if integration_s is not None:
            settings = replace(settings, frames=frames or 0, integration_s=integration_s)
        if method is not None:
            settings = replace(settings, method=method)
        return self.pictures.change(settings)

    def _check_sums_allow(self, method: str | None) -> None:
        """Refuse methods that need histograms while the camera sends sums."""
        if self.pictures.reduced and method not in (None, "sums"):
            raise CaptureError(f"method {method!r} needs histograms: {SUMS_SENT}")

    def stop(self) -> None:
        """End the present run, and stay idle.

        Raises
        ------
        CaptureError
            If a calibration, or a check of it, is in progress, whose captures must not end early.
        """
        self._check_captures_idle()
        self.acquisition.set_live(None)
        self.acquisition.stop()

    def controls(self) -> dict[str, Any]:
        """Return what of the camera may be changed, as it is, and the limits."""
        snapshot = self.acquisition.snapshot
        return (
            describe_controls(self.acquisition.controls)
            | {"actual_rate_hz": snapshot.rate_hz}
            | {"default_schedule": stated_schedule(self.stated)}
            | {"limits": describe_limits(self.instrument, snapshot)}
        )

    def set_controls(self, **changes: Any) -> None:
        """Change schedule, frame rate, pixels or codes; the live run begins again.

        A calibration belongs to the schedule with which it was made. After a change the newest
        one that fits is used; without one pictures show photons only.

        Parameters
        ----------
        **changes : Any
            Attributes of `CameraControls` that are to change.

        Raises
        ------
        CaptureError
            If a recording, a calibration or a check of it is in progress.
        HueflightError
            If a value is out of its range.
        """
        with self.recording_job.keep_off():
            self.recording_job.check_idle()
            self._check_captures_idle()
            snapshot, stated = self.acquisition.snapshot, self.stated
            controls = replace(self.acquisition.controls, **changes)
            controls = controls.in_ticks(stated, snapshot.capacity)
            controls.check(stated, snapshot.timing)
            with self._using:
                self.settings = run_settings(self.config, controls.instrument(stated))
                # tables belong to one schedule and one number of frames: they are made anew
                controls = replace(controls, reduction=None, codes_rate_hz=None)
                self._follow(controls.scheduled(stated))
                self.acquisition.set_controls(controls, self.settings)
        log.info("controls changed", **describe_controls(controls))

    def _follow(self, instrument: Instrument) -> None:
        """Show the pictures of the next run, which may have another schedule."""
        changed = instrument != self.instrument
        self.instrument, self._fingerprint = instrument, instrument.fingerprint()
        self.pictures.follow(self.settings, instrument)
        if changed:
            self.check_job.forget()
            self.calibration_job.follow(instrument)
            self.simulated_part.follow_schedule()

    def rename_recording(self, name: str, new_name: str, /) -> None:
        """Give a recording another name.

        Parameters
        ----------
        name, new_name : str
            Name of the recording, and the name that it is given.

        Raises
        ------
        HueflightError
            If the recording is in progress, being finished or not there, or the new name is taken.
        """
        with self.recording_job.keep_off(name, new_name):
            self.finisher.check_idle(name)
            self.folder.rename(name, new_name)
        log.info("recording renamed", name=name, new_name=new_name)

    def delete_recording(self, name: str, /) -> None:
        """Delete a recording.

        Parameters
        ----------
        name : str
            Name of the recording.

        Raises
        ------
        HueflightError
            If the recording is in progress, being finished or not there.
        """
        with self.recording_job.keep_off(name):
            self.finisher.check_idle(name)
            self.folder.delete(name)
        log.info("recording deleted", name=name)

    def status(self) -> dict[str, Any]:
        """Return the current status, for the live page, scripts and metrics."""
        snapshot, thread = self.acquisition.snapshot, self.acquisition.thread
        now = time.monotonic()
        self.rates.update(
            now,
            frames=snapshot.totals.delivered,
            photons=snapshot.photons,
            bytes=snapshot.received_bytes,
            pictures=self.pictures.made,
        )
        return {
            "name": self.config.name,
            "instrument": self.instrument.name,
            "fingerprint": self._fingerprint,
            "state": "failed" if thread.failure or thread.stuck() else snapshot.state,
            "problem": "; ".join(dict.fromkeys(self._words_about_problems(snapshot))),
            "parts": self.parts(),
            **run_status(snapshot),
            "simulation": self.simulated_part.status(),
            "rates": self.rates.per_second(),
            "picture": picture_status(self.pictures, now_s=now, stale_after_s=self.stale_after_s),
            "calibration": calibration_status(
                self.calibration_job, calibrated=self.pictures.calibration is not None
            ),
            "check": self.check_job.state.as_dict(),
            "stream": self.codes_choice.as_dict(),
            "recording": recording_status(self.recording_job, snapshot),
            "latency_s": self.latencies.as_dict(),
            "viewers": self.viewers,
            "uptime_s": now - self._started_s,
        }

    def parts(self) -> dict[str, dict[str, Any]]:
        """Return for each part of the daemon whether it works.

        Returns
        -------
        dict of dict
            State (``"working"``, ``"failed"`` or ``"stuck"``), problem in words and number of
            failures, by the name of the part.
        """
        snapshot = self.acquisition.snapshot
        interrupted = snapshot.recording_failure if snapshot.recording_paused else ""
        failures = self._events["recording paused"] + self._events["recorder failed"]
        return {
            "acquisition": _part(self.acquisition.thread),
            "recorder": {
                "state": "failed" if interrupted else "working",
                "problem": interrupted,
                "failures": failures,
            },
            "pictures": _part(self.pictures.thread),
            "codes or sums": _part(self.codes_choice.thread),
            "disk": _part(self.disk.thread, problem=self.disk.problem),
            "finisher": _part(self.finisher.thread),
        }

    def problems(self) -> list[str]:
        """Return what makes the daemon unhealthy, in words; empty if nothing does."""
        snapshot = self.acquisition.snapshot
        found = [part["problem"] for part in self.parts().values()]
        found.append(snapshot.recording_failure)
        if snapshot.state in ("disconnected", "failed"):
            found.append(snapshot.problem)
        return list(dict.fromkeys(text for text in found if text))

    def _words_about_problems(self, snapshot: Snapshot) -> list[str]:
        found = [snapshot.problem, self.pictures.problem, *self.problems()]
        return [text for text in found if text]

    @property
    def hangs(self) -> bool:
        """True if acquisition or pictures hang, so that only a new process can help."""
        return any(part.thread.stuck() for part in (self.acquisition, self.pictures))

    @property
    def stale_after_s(self) -> float:
        """Age in seconds from which a picture no longer counts as live."""
        interval = self.settings.block_frames / self.settings.rate_hz
        return max(STALE_S, 3 * interval)

    def describe(self) -> dict[str, Any]:
        """Return the facts about the instrument, which change with its schedule only."""
        return describe_instrument(self.instrument) | {
            "protocol": PROTOCOL,
            "definition": self.instrument.to_json(),
            "materials": self.materials.names,
        }

    def close(self) -> None:
        """End everything in order, so that recordings are finished."""
        self.simulated_part.close()
        self.calibration_job.close()
        self.codes_choice.close()
        self.acquisition.close()
        self.pictures.close()
        self.playback.close()
        self.finisher.close()
        self.disk.close()


def _part(thread: SupervisedThread, /, *, problem: str = "") -> dict[str, Any]:
    """State of a part that has a thread of its own."""
    stuck = thread.stuck()
    problem = stuck or thread.failure or problem
    state = "stuck" if stuck else "failed" if problem else "working"
    return {"state": state, "problem": problem, "failures": thread.failures}
