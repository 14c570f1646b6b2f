# SPDX-License-Identifier: Apache-2.0
"""Two hundred captures by one worker, by two, and by a Dask cluster: the same images."""

from collections.abc import Callable
from pathlib import Path

import distributed
import numpy as np
import pytest

import hueflight as hf
from hueflight.batch import BatchReport, reconstruct_many
from hueflight.importers import read_image
from hueflight.importers.captures import write_counts

CAPTURES = 200

pytestmark = [
    pytest.mark.slow,
    # what dask's own shutdown leaves open is not ours to mend
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning"),
]


@pytest.fixture(scope="module")
def many(
    small: Callable[..., hf.Instrument],
    draw: Callable[..., np.ndarray],
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[list[Path], hf.Calibration]:
    camera = small(rows=16, cols=12)
    folder = tmp_path_factory.mktemp("many")
    paths = [folder / f"run{number:03d}.npz" for number in range(CAPTURES)]
    for number, path in enumerate(paths):
        write_counts(path, draw(camera, depth=0.3 + 0.01 * number, seed=number), camera)
    reference = draw(camera, depth=0.4, photons=20_000, seed=1000)
    return paths, hf.calibrate(reference, camera, distance=0.4)


def peaks(report: BatchReport) -> dict[str, list[int]]:
    """Peak memory of each worker, in the order of its tasks."""
    found: dict[str, list[int]] = {}
    for outcome in report.outcomes:
        found.setdefault(outcome.worker, []).append(outcome.peak_memory_bytes)
    return found


def test_the_same_whoever_works(many: tuple[list[Path], hf.Calibration], tmp_path: Path) -> None:
    paths, calibration = many
    one = reconstruct_many(paths, tmp_path / "one", calibration=calibration, workers=1)
    two = reconstruct_many(paths, tmp_path / "two", calibration=calibration, workers=2)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        dask = reconstruct_many(
            paths, tmp_path / "dask", calibration=calibration, scheduler=cluster.scheduler_address
        )
    for report in (one, two, dask):
        assert not report.failed
    for outcomes in zip(one.outcomes, two.outcomes, dask.outcomes, strict=True):
        images = [read_image(outcome.store) for outcome in outcomes]
        for other in images[1:]:
            for name in images[0].variables:
                np.testing.assert_array_equal(images[0][name], other[name])
    # depth follows what was drawn, capture by capture: a mean of 192 pixels is good to 1 mm
    means = [float(read_image(outcome.store)["depth"].mean()) for outcome in two.outcomes]
    np.testing.assert_allclose(means, 0.3 + 0.01 * np.arange(CAPTURES), atol=0.02)
    assert len(peaks(two)) == 2
    assert all(len(history) > CAPTURES / 4 for history in peaks(two).values()), "both had work"
    # what a worker holds does not grow with the number of captures behind it
    for report in (one, two):
        for history in peaks(report).values():
            assert max(history) < 1.1 * history[len(history) // 5]
