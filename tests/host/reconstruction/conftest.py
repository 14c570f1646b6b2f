"""What tests of reconstruction share."""

import os

import pytest

from hueflight.reconstruction.kernels import compiled_kernel


@pytest.fixture
def compiled_fit():
    """The compiled fit is there; where it was not built a test is skipped, but in CI fails."""
    if compiled_kernel() is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)("no compiled fit was built")
