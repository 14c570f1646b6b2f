"""The daemon without its doors: acquisition, pictures, recordings and calibrations together."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import structlog

from hueflight.acquisition.plan import CaptureError, RunPlan, RunResult
from hueflight.acquisition.precision_stop import PrecisionStop
from hueflight.acquisition.run import RunSettings
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.snapshot import LiveBlock
from hueflight.acquisition.summary import write_summary
from hueflight.calibration import Calibration
from hueflight.daemon.calibration_job import CalibrationJob
from hueflight.daemon.config import DaemonConfig
from hueflight.daemon.latency import Latencies
from hueflight.daemon.live_color import Palette
from hueflight.daemon.pictures import Picture, Pictures
from hueflight.daemon.rate_meter import Rates
from hueflight.daemon.recordings_folder import FileNameError, Folder, timestamp_name
from hueflight.devices.illumination import GUIDANCE, CaptureKind
from hueflight.devices.rig import Connect
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.stopping import StopRule

log = structlog.get_logger("hueflight.daemon")
STALE_S = 2.0  #: a picture older than this, or than three intervals, is stale
LIVE = RunPlan(live=True)


class Service:
    """One camera's daemon.

    Parameters
    ----------
    config : as read from TOML.
    connect : opens the rig.
    instrument : that it is.
    on_picture : told of each picture, in another thread.
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
        self.config, self.instrument = config, instrument
        self.folder = Folder(config.folder / "recordings")
        self.rates = Rates()
        self.latencies = Latencies()
        self.palette = Palette(instrument)
        self.started_s = time.monotonic()
        self.viewers = 0
        self._lock = threading.Lock()
        self._recording_name = ""
        self._recording: Future[RunResult] | None = None
        self.last_recording: dict[str, Any] = {}
        settings = RunSettings.of(
            instrument,
            pictures_hz=config.pictures_hz or None,
            picture_frames=config.picture_frames or None,
        )
        self.settings = RunSettings(
            settings.rate_hz,
            settings.block_frames,
            settings.window_blocks,
            threads=config.threads,
            recorder_queue_bytes=config.recording.queue_mb << 20,
            min_free_bytes=config.recording.min_free_mb << 20,
        )
        self.pictures = Pictures(
            instrument,
            method=config.method,
            window_blocks=settings.window_blocks,
            change_sigma=config.change_sigma,
            threads=config.picture_threads or os.cpu_count() or 1,
            on_picture=on_picture,
            looked_at=lambda: self.viewers > 0,
        )
        self.acquisition = Acquisition(
            connect,
            instrument,
            settings=self.settings,
            live=LIVE,
            on_block=self._on_block,
            on_event=lambda name, details: log.info(name, **details),
        )
        self.calibrating = CalibrationJob(
            self.acquisition, config.folder / "calibrations", use=self._use
        )
        self.calibrating.load_latest(instrument)

    def _on_block(self, block: LiveBlock) -> None:
        self.pictures.offer(block)

    def _use(self, calibration: Calibration) -> None:
        calibration.require(self.instrument)
        self.palette = Palette(self.instrument, calibration.emission)
        self.pictures.calibration = calibration

    # -- commands -----------------------------------------------------------------------------

    def start(self) -> None:
        """Acquire live."""
        self.acquisition.set_live(LIVE)

    def stop(self) -> None:
        """End the live run and any other; stay idle."""
        self.acquisition.set_live(None)
        self.acquisition.stop()

    def record(
        self,
        *,
        name: str = "",
        kind: CaptureKind = "scene",
        frames: int = 0,
        seconds: float | None = None,
        note: str = "",
        until: StopRule | None = None,
    ) -> str:
        """Begin a recording; return its name.

        Raises
        ------
        FileNameError
            If the name is not allowed or taken.
        CaptureError
            If one is being made, the limits make no sense, or `until` is given and there is no
            calibration to tell how well pixels are known.
        """
        with self._lock:
            if self._recording_name:
                raise CaptureError(
                    f"recording {self._recording_name!r} is being made: stop it first"
                )
            calibration = self.pictures.calibration
            if until is not None and calibration is None:
                raise CaptureError(
                    "no calibration tells how well pixels are known: calibrate first, or end the "
                    "recording by frames or seconds"
                )
            name = name or timestamp_name()
            path = self.folder.fresh(name)
            metadata = {"daemon": self.config.name} | ({"note": note} if note else {})
            stop = (
                None if until is None or calibration is None else PrecisionStop(until, calibration)
            )
            plan = RunPlan(
                kind=kind, frames=frames, seconds=seconds, path=path, until=stop, metadata=metadata
            )
            plan.check()
            self._recording_name = name
        future = self._recording = self.acquisition.run(plan)
        future.add_done_callback(lambda done: self._recorded(name, done))
        return name

    def _recorded(self, name: str, done: Future[RunResult]) -> None:
        """Called when a recording has ended, however."""
        with self._lock:
            self._recording_name = ""
        error = None if done.cancelled() else done.exception()
        if error is not None or done.cancelled():
            reason = str(error or "stopped before it began")
            self.last_recording = {"name": name, "failure": reason}
            log.error("recording failed", name=name, reason=reason)
            return
        self.last_recording = write_summary(self.folder.path(name), done.result())
        log.info("recording ended", **self.last_recording)

    def stop_recording(self) -> str:
        """End the recording that is being made; return its name.

        Raises
        ------
        CaptureError
            If there is none.
        """
        with self._lock:
            name = self._recording_name
        if not name:
            raise CaptureError("no recording is being made")
        future = self._recording
        if future is None or not future.cancel():  # else it had not begun
            self.acquisition.stop()
        return name

    @property
    def recording_name(self) -> str:
        """Of the recording that is being made, empty if none."""
        return self._recording_name

    # -- state --------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """How things stand, for pages, scripts and metrics."""
        snapshot = self.acquisition.snapshot
        now = time.monotonic()
        self.rates.update(
            now, frames=snapshot.totals.delivered, photons=snapshot.photons,
            bytes=snapshot.received_bytes, pictures=self.pictures.made,
        )  # fmt: skip
        picture = self.pictures.latest
        age = None if picture is None else now - picture.received_s
        return {
            "name": self.config.name,
            "instrument": self.instrument.name,
            "state": snapshot.state,
            "problem": snapshot.problem or self.pictures.problem,
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
            "rates": self.rates.per_second(),
            "picture": {
                "number": picture.number if picture else 0,
                "age_s": age,
                "stale": age is None or age > self.stale_after_s,
                "stale_after_s": self.stale_after_s,
                "skipped": self.pictures.skipped,
                "method": self.pictures.method,
            },
            "calibration": {
                "step": self.calibrating.state.step,
                "message": self.calibrating.state.message,
                "path": self.calibrating.state.path,
                "calibrated": self.pictures.calibration is not None,
            },
            "recording": {
                "name": self._recording_name,
                "frames": snapshot.recorded_frames,
                "bytes": snapshot.recorded_bytes,
                "queue_bytes": snapshot.recorder_queue_bytes,
                "failure": snapshot.recording_failure,
                "last": self.last_recording,
            },
            "link": {
                "queue_bytes": snapshot.stream.queued_bytes,
                "stalls": snapshot.stream.stalls,
                "stalled_s": snapshot.stream.stalled_s,
                "errors": snapshot.stream.link_errors,
                "connections": snapshot.connections,
            },
            "gaps": [
                {
                    "started": gap.started,
                    "seconds": gap.seconds,
                    "reason": gap.reason,
                    "frames_lost": gap.frames_lost,
                }
                for gap in snapshot.gaps[-10:]
            ],
            "latency_s": self.latencies.as_dict(),
            "viewers": self.viewers,
            "uptime_s": now - self.started_s,
        }

    @property
    def stale_after_s(self) -> float:
        """Age from which a picture is not live any more."""
        interval = self.settings.block_frames / self.settings.rate_hz
        return max(STALE_S, 3 * interval)

    def describe(self) -> dict[str, Any]:
        """What does not change while the daemon runs."""
        instrument = self.instrument
        right, down = instrument.ray_slopes()
        return {
            "name": instrument.name,
            "description": instrument.description,
            "rows": instrument.image_shape[0],
            "cols": instrument.image_shape[1],
            "codes": instrument.sensor.codes,
            "frame_rate_hz": instrument.sensor.frame_rate_hz,
            "period_ns": instrument.timing.period_ns,
            "pixel_aspect": (instrument.sensor.pixel_height_um or 1)
            / (instrument.sensor.pixel_width_um or 1),
            "slope_right": float(right[0, -1]),
            "slope_down": float(down[-1, 0]),
            "fingerprint": instrument.fingerprint(),
            "bands": [
                {"name": band.name, "wavelength_nm": band.wavelength_nm,
                 "fwhm_nm": band.emission_fwhm_nm}
                for band in instrument.bands
            ],
            "guidance": GUIDANCE,
        }  # fmt: skip

    def close(self) -> None:
        """End everything in order; recordings are finished."""
        self.calibrating.close()
        self.acquisition.close()
        self.pictures.close()


__all__ = ["CaptureError", "FileNameError", "Service"]
