# SPDX-License-Identifier: Apache-2.0
"""Kernels refuse buffers that do not fit one another, and write nothing; `ingest` has its own test.

Each call that a reconstruction makes is made again, with one of its arguments changed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hueflight.backend import KERNELS, available
from hueflight.backend.interface import Function

pytestmark = pytest.mark.skipif(not all(map(available, KERNELS)), reason="no compiled kernels here")
TOOLS = Path(__file__).resolve().parents[3] / "tools" / "evidence"
FUNCTIONS = {
    f"{name}.{function.name}": function
    for name, kernel in KERNELS.items()
    if name != "ingest"
    for function in kernel.interface.functions
    if isinstance(function, Function)
}
OF_COUNTS = [name for name, each in FUNCTIONS.items() if each.buffers[1].name == "pixels"]
FITS = "rules delay_ns delay_std_ns other_ns detection chi_square misfit"
#: arguments whose size the kernel compares with others; it also does so with all that it fills
READS = {
    "fit.fit": "sizes rules offsets rates contrasts curvatures moments",
    "fit.change_reference": "sizes rules delays amplitudes background",
    "fit.changes": "sizes rules span exposures earlier delays weights kept",
    "fit.sums": "span",
    "fit.correlations": "sizes reference pixel_delays",
    "fit.verdicts": f"{FITS} meters_per_ns",
    "fit.picture": f"{FITS} flags amplitudes amplitude_std background places fits photons base "
    "meters_per_ns delay_variance brightness_variance flat_field inverse uncertainty scale table "
    "placement luck_cells",
    "fit.surface_starts": "depth deviation size",
    "pooled.list": "counts code_times pixel_delays period",
    "pooled.lags": "starts times weights lags grid",
    "pooled.windows": "starts times weights delays grid",
    "pooled.squares": "starts times weights size pixels reach delays grid",
    "pooled.scores": "starts times weights delays shares slopes floors grid",
    "pooled.pool": "sizes limits steps kernel roots delays valid data trust information active",
    "sums.estimate": "sizes sums number whiten dark_test separate slopes dark covariances nulls",
}
TABLES = ("fit.fit", "fit.change_reference", "fit.changes")
#: changes of records that the kernel must refuse
RECORDS = [
    *((name, "sizes", "bands", value) for name in TABLES for value in (0, 31)),
    *((name, "rules", "nodes", value) for name in TABLES for value in (0, 33)),
    *((name, "sizes", "sensor_bins", 7) for name in TABLES),
    ("fit.fit", "rules", "points", 1),
    ("fit.fit", "rules", "points", 7),
    ("fit.fit", "rules", "contrasts", 3),
    *(("fit.correlations", "sizes", "search", value) for value in (-1, 1 << 20)),
    *(("fit.correlations", "sizes", "reach", value) for value in (-1, 1 << 20)),
    *(("fit.correlations", "sizes", "most", value) for value in (0, 1 << 20)),
    *(("fit.correlations", "sizes", "bands", value) for value in (0, 1, 1 << 20)),
    ("fit.correlations", "sizes", "half_width", 1e9),
    *(("fit.picture", "scale", "points", value) for value in (1, 7)),
    *(
        ("fit.surface_starts", "size", name, value)
        for name in ("rows", "cols")
        for value in (4, 99)
    ),
    *(("sums.estimate", "sizes", "bands", value) for value in (0, 99)),
    *(("sums.estimate", "sizes", "sums", value) for value in (2, 999)),
    *(("sums.estimate", "sizes", "lags", value) for value in (2, 1 << 20)),
    *(("sums.estimate", "sizes", name, 0) for name in ("lag_phases", "rest")),
    *(("pooled.squares", "size", name, value) for name in ("rows", "cols") for value in (0, 99)),
    *(("pooled.pool", "sizes", name, -1) for name in ("first_row", "rim", "spectral")),
    *(("pooled.pool", "sizes", name, 0) for name in ("cols", "groups", "planes")),
    *(("pooled.pool", "sizes", name, 99) for name in ("first_row", "end_row", "groups", "planes")),
    ("pooled.pool", "sizes", "spectral", 99),
]
#: changes of arrays: an element that the kernel must refuse
ELEMENTS = [
    *(
        (f"fit.{name}", "span", place, value)
        for name in ("sums", "changes")
        for place, value in ((0, -1), (1, 0), (1, 1 << 20))
    ),
    *(("fit.picture", "places", 0, value) for value in (-1, 1 << 40)),
    ("fit.picture", "fits", 0, 5),
    *(("fit.correlations", "windows", 0, value) for value in (-1, 99)),
    *(("fit.correlations", "gaps", 0, value) for value in (-1, 1 << 20)),
    *(("pooled.lags", "lags", 0, value) for value in (-(1 << 20), 1 << 20)),
    *(("pooled.windows", "owners", 0, value) for value in (-1, 99)),
    ("pooled.lags", "starts", -1, 1 << 40),
    *(("pooled.squares", "pixels", 0, value) for value in (-1, 1 << 40)),
    *(("pooled.squares", "reach", 0, value) for value in (-1, 1 << 20)),
    *(("pooled.squares", "owners", 0, value) for value in (-1, 99)),
    *(("pooled.pool", "steps", 0, value) for value in (-99, 99)),
    *(("sums.estimate", "number", 0, value) for value in (-1, 99)),
]


@pytest.fixture(scope="module")
def calls() -> Iterator[dict[str, Callable[[], tuple[Any, list[Any]]]]]:
    """By name of a kernel and a function: that function, and arguments of a call, made anew."""
    sys.path.insert(0, str(TOOLS))
    workload = import_module("workload")
    sys.path.remove(str(TOOLS))
    with workload.recorded_calls(keep=1) as recorded:
        workload.work(threads=1)
    builds = {build: name for name, kernel in KERNELS.items() for build in kernel.builds}

    def again(call: Any) -> tuple[Any, list[Any]]:
        arguments = [np.array(each) for each in call.arguments]
        return getattr(import_module(call.module), call.function), arguments

    yield {
        f"{builds[call.module]}.{call.function}": lambda call=call: again(call) for call in recorded
    }
    sys.modules.pop("workload", None)


def place_of(name: str, argument: str) -> int:
    return [buffer.name for buffer in FUNCTIONS[name].buffers].index(argument)


def refused(
    calls: Any, name: str, argument: int, value: Any, error: Any, match: str | None = None
) -> None:
    """Call a function with another value of an argument: it must refuse it, and write nothing."""
    function, arguments = calls[name]()
    arguments[argument] = value
    outputs = [each for each in arguments[len(FUNCTIONS[name].reads) :] if each is not None]
    before = [np.array(each) for each in outputs]
    with pytest.raises(error, match=match):
        function(*arguments)
    for now, then in zip(outputs, before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_the_work_calls_every_function(calls: Any) -> None:
    declared = {
        f"{name}.{function.name}"
        for name, kernel in KERNELS.items()
        for function in kernel.interface.functions
    }
    assert declared <= set(calls)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_call_itself_is_accepted(calls: Any, name: str) -> None:
    function, arguments = calls[name]()
    assert function(*arguments) is None
    with pytest.raises(TypeError, match="buffers"):
        function(*arguments[:-1])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_no_memory_is_refused(calls: Any, name: str) -> None:
    for argument in range(len(FUNCTIONS[name].buffers)):
        refused(calls, name, argument, None, TypeError, "bytes-like object is required")


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_may_not_be_written_is_refused(calls: Any, name: str) -> None:
    for argument in range(len(FUNCTIONS[name].reads), len(FUNCTIONS[name].buffers)):
        fixed = calls[name]()[1][argument]
        fixed.flags.writeable = False
        refused(calls, name, argument, fixed, (ValueError, BufferError), "read-only|writable")


@pytest.mark.parametrize("name", FUNCTIONS)
def test_buffers_that_are_too_short_are_refused(calls: Any, name: str) -> None:
    function = FUNCTIONS[name]
    names = [*READS.get(name, "").split(), *(buffer.name for buffer in function.writes)]
    for argument in (place_of(name, each) for each in names):
        given = calls[name]()[1][argument].reshape(-1)
        # an empty one stands for none: one element is too few for the pixels then
        short = given[:-1].copy() if given.size else np.zeros(1, given.dtype)
        refused(calls, name, argument, short, ValueError, "fit|smaller than a window")


@pytest.mark.parametrize(("name", "argument", "field", "value"), RECORDS)
def test_records_that_do_not_fit_are_refused(
    calls: Any, name: str, argument: str, field: str, value: Any
) -> None:
    place = place_of(name, argument)
    record = calls[name]()[1][place]
    record = record.view(FUNCTIONS[name].buffers[place].type.dtype)
    record[field] = value
    refused(calls, name, place, record, ValueError, "fit one another|smaller than a window")


@pytest.mark.parametrize(("name", "argument", "element", "value"), ELEMENTS)
def test_numbers_out_of_range_are_refused(
    calls: Any, name: str, argument: str, element: int, value: int
) -> None:
    place = place_of(name, argument)
    array = calls[name]()[1][place].copy()
    array.reshape(-1)[element] = value
    refused(calls, name, place, array, ValueError, "fit one another")


@pytest.mark.parametrize("name", OF_COUNTS)
def test_counts_and_pixels_are_checked(calls: Any, name: str) -> None:
    counts = calls[name]()[1][0]
    for wrong in (counts.astype(np.float64), counts.reshape(-1), counts.astype(np.uint8)):
        refused(calls, name, 0, wrong, ValueError, "counts must be")
    for pixel in (-1, len(counts)):
        refused(calls, name, 1, np.array([pixel], np.int64), IndexError, "no such pixel")


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if "starts" in READS[name].split()])
def test_photons_of_no_pixel_are_refused(calls: Any, name: str) -> None:
    """Neither the first place of a pixel nor the end of the last one is there."""
    nothing = np.empty(0, np.int64)
    refused(calls, name, place_of(name, "starts"), nothing, ValueError, "do not fit one another")


def test_counts_of_another_type_are_not_listed(calls: Any) -> None:
    at = place_of("pooled.list", "counts")
    counts = np.asarray(calls["pooled.list"]()[1][at]).astype(np.float64)
    refused(calls, "pooled.list", at, counts, ValueError, "do not fit one another")
