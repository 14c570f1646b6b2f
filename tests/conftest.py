# SPDX-License-Identifier: Apache-2.0
"""Which tests run, in what order, what may be skipped, and where real measurements lie.

Tests skip, saying so, what a machine lacks. Continuous integration must lack nothing: there a skip
for any reason but those listed here is a failure.
"""

import os
from collections.abc import Generator
from pathlib import Path

import pytest

# The linear algebra of NumPy and SciPy would wait in busy loops for as many threads as there are
# processors, and tests already keep them all busy. Set before NumPy is loaded; commands inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

try:
    from hypothesis import settings
except ImportError:  # the environment of other programs runs no property tests
    pass
else:
    # No test may depend on the speed of the machine, and a failure must come again.
    settings.register_profile("hueflight", deadline=None, derandomize=True)
    settings.load_profile("hueflight")

ROOT = Path(__file__).resolve().parent.parent
REAL_DATA = ROOT.parent / "shared" / "data"
MAY_LACK = (  #: beginnings of the reasons for which CI may skip
    "slow: ",  # run without --full
    "real measurements are not ",  # they are no part of the project
    "measured spectra are not ",
    "this processor can't run ",  # a build of the kernels for another one
    "this user may not mount ",  # disks of a test
    "udevadm 252 has no verify",  # that of Debian 12
)
#: programs whose tests run in an environment of their own: tools/dev.py programs
OTHER_PROGRAMS = "other programs are not installed: "
if not os.environ.get("HUEFLIGHT_PROGRAMS"):
    MAY_LACK += (OTHER_PROGRAMS,)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="run the slow tests too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--full"):
        # files with long tests begin first, so that no core waits at the end for another
        slow = {item.path for item in items if "slow" in item.keywords}
        items.sort(key=lambda item: item.path not in slow)
        return
    skip = pytest.mark.skip(reason="slow: runs with --full")
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(skip)


def forbid_skip(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Turn a skip into a failure where nothing may be missing."""
    if not os.environ.get("CI") or not report.skipped or hasattr(report, "wasxfail"):
        return
    where, line, said = report.longrepr if isinstance(report.longrepr, tuple) else ("", 0, "")
    reason = said.removeprefix("Skipped: ")
    if not reason.startswith(MAY_LACK):
        report.outcome = "failed"
        report.longrepr = f"{where}:{line}: skipped, which CI must not: {reason}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    forbid_skip(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    forbid_skip(report)
    return report


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with real measurements; tests that need it skip, saying so, without it."""
    if not REAL_DATA.is_dir():
        pytest.skip(f"real measurements are not beside the project ({REAL_DATA.name} absent)")
    return REAL_DATA
