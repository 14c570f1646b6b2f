# SPDX-License-Identifier: Apache-2.0
"""Estimates of memory, and the refusal of work that would not fit."""

import resource
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

import hueflight as hf
from hueflight import memory
from hueflight.calibration import procedure, waveform_estimation
from hueflight.errors import HueflightError, MemoryLimitError
from hueflight.fit import packing, tables
from hueflight.fit.tables import ScheduleView
from hueflight.model.time_bins import TimeBins
from hueflight.model.waveforms import Templates


@pytest.mark.parametrize(
    ("given", "expected"),
    [("4 GB", 4 * 10**9), ("1.5MB", 1_500_000), ("200 kB", 200_000), ("1000", 1000)],
)
def test_limit_of_the_user(monkeypatch, given, expected):
    monkeypatch.setenv(memory.LIMIT_NAME, given)
    assert memory.limit_bytes() == expected


@pytest.mark.parametrize("given", ["much", "-3 GB", "0", "nan", "inf", "4 parsecs"])
def test_limit_that_is_no_amount(monkeypatch, given):
    monkeypatch.setenv(memory.LIMIT_NAME, given)
    with pytest.raises(HueflightError, match=r"HUEFLIGHT_MEMORY = .*amount of memory"):
        memory.limit_bytes()


def test_limit_of_the_process():
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_DATA, (10**9, 10**9))\n"
        "from hueflight import memory; print(memory.limit_bytes())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) == 750_000_000
    assert resource.getrlimit(resource.RLIMIT_DATA)[0] == resource.RLIM_INFINITY


def test_a_refusal_says_how_much_and_what_to_do(monkeypatch):
    monkeypatch.setenv(memory.LIMIT_NAME, "1 MB")
    with pytest.raises(
        MemoryLimitError, match=r"the work would take about 2\.5 MB .* 1 MB .* Wait"
    ):
        memory.require_memory(2.5e6, "the work", advice="Wait")
    memory.require_memory(0.9e6, "the work", advice="Wait")
    assert issubclass(MemoryLimitError, MemoryError)


def wide_camera(bins=4096, *, even=True):
    period_ns = bins * 0.05
    made = TimeBins.nominal(
        codes=bins, first_code=0, bin_width_ns=0.05, period_ns=period_ns, reverse=False
    )
    if not even:
        made = made.with_widths(np.random.default_rng(1).uniform(0.04, 0.06, bins))
    time_ns = np.arange(bins) * 0.05
    pulses = [np.exp(-(((time_ns - at) / 0.15) ** 2) / 2) for at in (20.0, 60.0, 100.0)]
    return [ScheduleView(made, Templates.normalized(np.array(pulses), period_ns))]


@pytest.mark.parametrize("even", [True, False])
def test_estimate_of_the_tables_covers_what_they_take(monkeypatch, even):
    estimates = []
    monkeypatch.setattr(tables, "require_memory", lambda needed, *_, **__: estimates.append(needed))
    views = wide_camera(even=even)
    tracemalloc.start()
    made = tables.make_tables(
        views, shortest_fwhm_ns=0.35, brightness=np.ones(3), search_ns=(-20.0, 20.0)
    )
    packing.pack(made)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < estimates[0] < 3 * peak


def test_tables_are_refused_before_they_are_made(monkeypatch):
    monkeypatch.setenv(memory.LIMIT_NAME, "1 MB")
    tracemalloc.start()
    with pytest.raises(MemoryLimitError, match=r"delays, 3 bands and 4096 bins .*depth_range"):
        tables.make_tables(
            wide_camera(), shortest_fwhm_ns=0.35, brightness=np.ones(3), search_ns=(-20.0, 20.0)
        )
    assert tracemalloc.get_traced_memory()[1] < 2e7
    tracemalloc.stop()


def test_a_calibration_is_refused_before_it_begins(monkeypatch, small, draw):
    instrument = small()
    reference = draw(instrument, photons=2000)
    monkeypatch.setenv(memory.LIMIT_NAME, "100 kB")
    with pytest.raises(MemoryLimitError, match=r"the calibration of .* pixels"):
        hf.calibrate(reference, instrument, distance=0.5)


@pytest.mark.parametrize("code_zero", ["bin", "no photon"])
def test_estimate_of_a_calibration_covers_what_it_takes(monkeypatch, small, draw, code_zero):
    """At one photon in each exposure of every second kind, losses to pile-up are corrected too."""
    instrument = small(rows=64, cols=96, code_zero=code_zero)
    reference = draw(instrument, photons=3000).astype(np.uint16)
    if code_zero == "no photon":
        reference[..., 0] = reference[..., 1:].sum(axis=-1).max() + 100
    hf.calibrate(reference, instrument, distance=0.5)  # loads what is loaded once
    estimates = []
    monkeypatch.setattr(
        procedure, "require_memory", lambda needed, *_, **__: estimates.append(needed)
    )
    monkeypatch.setattr(waveform_estimation, "POOLED_BYTES", reference.nbytes // 20)
    tracemalloc.start()
    hf.calibrate(reference, instrument, distance=0.5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < estimates[0] < 2 * peak


def lack_memory(*_, **__):
    raise MemoryError


@pytest.mark.parametrize("method", ["joint", "paper"])
def test_a_reconstruction_that_runs_out_of_memory(monkeypatch, small, method):
    """Its error is Hueflight's and Python's, and there is nothing wrong with the next one."""
    instrument = small(rows=4, cols=4)
    counts = np.zeros(instrument.histogram_shape, np.uint16)
    counts[..., 100:140] = 30
    calibration = hf.calibrate(
        hf.simulator.simulate_capture("reference", instrument, frames=20000, seed=2),
        instrument,
        distance=0.4,
    )
    expected = hf.reconstruct(counts, calibration, method=method)
    with monkeypatch.context() as patch:
        patch.setattr("hueflight.reconstruction.entry_point.as_image", lack_memory)
        with pytest.raises(
            MemoryLimitError, match=r"memory is exhausted: the reconstruction was given up\. Recon"
        ):
            hf.reconstruct(counts, calibration, method=method)
    assert hf.reconstruct(counts, calibration, method=method).identical(expected)


def test_a_refusal_keeps_its_own_words():
    with (
        pytest.raises(MemoryLimitError, match=r"^too much$"),
        memory.within_memory("x", advice="y"),
    ):
        raise MemoryLimitError("too much")


def test_the_command_line_says_so(monkeypatch, capsys):
    from hueflight.cli import app

    monkeypatch.setattr(app, "application", lack_memory)
    with pytest.raises(SystemExit) as ended:
        app.main(["info", "x"])
    assert ended.value.code == 1
    said = capsys.readouterr().err
    assert "memory is exhausted: end other programs, or work on less at a time" in said
