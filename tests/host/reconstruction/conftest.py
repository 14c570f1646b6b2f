"""What tests of reconstruction share."""

import pytest

from hueflight.reconstruction.kernels import compiled_kernel


@pytest.fixture
def compiled_fit() -> None:
    """The compiled fit is there, or the test is skipped."""
    if compiled_kernel() is None:
        pytest.skip("no compiled fit was built")
