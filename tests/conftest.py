"""Switch for the fuller tests, their order, and where real measurements lie if they are there."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
REAL_DATA = ROOT.parent / "shared" / "data"


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


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with real measurements; tests that need it skip, saying so, without it."""
    if not REAL_DATA.is_dir():
        pytest.skip(f"real measurements are not beside the project ({REAL_DATA.name} absent)")
    return REAL_DATA
