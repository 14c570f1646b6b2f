# SPDX-License-Identifier: Apache-2.0
"""Bluesky's run engine with our detector: documents, and the Zarr store that they refer to."""

from __future__ import annotations

import warnings
from collections import defaultdict
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
import xarray as xr

pytest.importorskip("ophyd_async", reason="other programs are not installed: extra 'bluesky'")
pytest.importorskip("bluesky", reason="other programs are not installed: extra 'bluesky'")

with warnings.catch_warnings():  # those of their dependencies
    warnings.simplefilter("ignore")
    import bluesky.plan_stubs as bps
    import bluesky.plans as bp
    from bluesky.run_engine import RunEngine
    from bluesky.utils import FailedStatus
    from event_model import DocumentNames, schema_validators
    from ophyd_async.core import (
        NotConnectedError,
        StaticFilenameProvider,
        StaticPathProvider,
        TriggerInfo,
        init_devices,
    )
    from ophyd_async.sim import SimMotor

import hueflight as hf
from hueflight.integrations.bluesky import HueflightDetector
from support.daemon_process import Daemon

pytestmark = pytest.mark.filterwarnings("ignore")
Documents = dict[str, list[dict[str, Any]]]


@pytest.fixture
def engine() -> RunEngine:
    return RunEngine(call_returns_result=True)


def made(engine: RunEngine, address: str, folder: Path, **options: Any) -> HueflightDetector:
    paths = StaticPathProvider(StaticFilenameProvider("scan"), folder)
    with init_devices():
        camera = HueflightDetector(address, paths, **options)
    return camera  # noqa: RET504 - named after its variable


def run(engine: RunEngine, plan: Any) -> Documents:
    """The documents of a plan by name, each valid by event-model's schema."""
    found: Documents = defaultdict(list)

    def take(name: str, document: dict[str, Any]) -> None:
        schema_validators[DocumentNames[name]].validate(document)
        found[name].append(document)

    engine(plan, take)
    return found


def test_a_plan_of_ten_points(engine: RunEngine, calibrated: Daemon, tmp_path: Path) -> None:
    camera = made(engine, calibrated.url, tmp_path, frames=48)
    with init_devices():
        motor = SimMotor(instant=True)
    documents = run(engine, bp.scan([camera], motor, 0.0, 9.0, num=10))
    assert len(documents["event"]) == 10
    [stop] = documents["stop"]
    assert stop["exit_status"] == "success"
    assert stop["num_events"]["primary"] == 10
    resources = {each["data_key"]: each for each in documents["stream_resource"]}
    assert {*resources} == {
        f"camera-{name}"
        for name in ("depth", "depth_std", "reflectance", "reflectance_std", "photons", "quality")
    }
    [uri] = {each["uri"] for each in resources.values()}
    data = xr.open_zarr(urlsplit(uri).path, consolidated=False)
    [descriptor] = documents["descriptor"]
    for key, resource in resources.items():
        assert resource["mimetype"] == "application/x-zarr"
        values = data[resource["parameters"]["dataset"]]
        described = descriptor["data_keys"][key]
        assert values.shape == (10, *described["shape"][1:])
        assert values.dtype == np.dtype(described["dtype_numpy"])
    covered = defaultdict(list)
    for datum in documents["stream_datum"]:
        covered[datum["stream_resource"]] += range(*datum["indices"].values())
    assert all(indices == list(range(10)) for indices in covered.values())
    assert len(covered) == len(resources)
    # each point has photons of its own: 48 frames that do not overlap
    assert (data.frames.values == 48).all()
    assert (np.diff(data.received_unix_s.values) >= 48 / 480).all()
    per_frame = data.photons.sum(["row", "col"]).values / 48
    assert per_frame == pytest.approx(per_frame.mean(), rel=0.05)
    assert np.isfinite(data.depth.values).mean() > 0.05
    assert data.wavelength.values.tolist() == hf.Instrument.load("paper").wavelengths_nm.tolist()
    configuration = descriptor["configuration"]["camera"]["data"]
    assert configuration["camera-frames"] == 48
    assert descriptor["hints"]["camera"]["fields"] == ["camera-depth"]


def test_a_live_time_sets_the_frames_and_the_daemon_records(
    engine: RunEngine, calibrated: Daemon, tmp_path: Path
) -> None:
    camera = made(engine, calibrated.url, tmp_path, arrays=["photons"], record=True)

    def plan() -> Any:
        yield from bps.stage(camera, wait=True)
        yield from bps.prepare(camera, TriggerInfo(livetime=0.2), wait=True)
        yield from bps.open_run()
        for _ in range(2):
            yield from bps.trigger_and_read([camera])
        yield from bps.close_run()
        yield from bps.unstage(camera, wait=True)

    documents = run(engine, plan())
    assert len(documents["event"]) == 2
    data = xr.open_zarr(tmp_path / "scan.zarr", consolidated=False)
    assert data.frames.values.tolist() == [96, 96]
    with hf.connect(calibrated.url) as client:
        last = client.status()["recording"]["last"]
        assert last["recorded_frames"] >= 2 * 96
        assert sum(last["lost"].values()) == 0
        assert last["name"] in {each.name for each in client.recordings()}


def test_failures_reach_the_plan(engine: RunEngine, calibrated: Daemon, tmp_path: Path) -> None:
    with pytest.raises(NotConnectedError, match="localhost:9"):
        made(engine, "localhost:9", tmp_path)
    camera = made(engine, calibrated.url, tmp_path, arrays=["hue"])
    with pytest.raises(FailedStatus, match="no array 'hue'"):
        run(engine, bp.count([camera]))
    paths = StaticPathProvider(StaticFilenameProvider("scan"), tmp_path)
    lone = HueflightDetector(calibrated.url, paths, name="lone")
    with pytest.raises(FailedStatus, match="not connected"):
        run(engine, bp.count([lone]))
