# SPDX-License-Identifier: Apache-2.0
"""What follows the fit: reflectances, and where surfaces are looked for, compiled and defined."""

import numpy as np
import pytest

from hueflight import backend
from hueflight.errors import KernelError
from hueflight.fit.reference import no_fit
from hueflight.reconstruction.edges import WINDOW, inner_starts
from hueflight.reconstruction.reflectances import LightScale, reflectances

pytestmark = pytest.mark.usefixtures("compiled_fit")


@pytest.fixture
def both_ways(monkeypatch):
    """Results of a function compiled and of its definition."""

    def run(function, *arguments):
        found = []
        for kernels in ("c", "numpy"):
            monkeypatch.setenv("HUEFLIGHT_KERNELS", kernels)
            found.append(function(*arguments))
        return found

    return run


def test_a_reflectance_has_the_variance_of_its_parts():
    found = no_fit(1, 1)
    found.amplitudes[:], found.amplitude_std[:] = 100.0, 10.0
    unit = np.ones(1)
    scale = LightScale(0.01 * unit, 0.0004 * unit, 0.03 * unit, unit, 0.0009 * unit, 2.0)
    value, deviation = reflectances(found, scale)
    assert value == pytest.approx(1.0)
    # 10 % of photons with twice the variance, 2 % and 3 % of brightness, 3 % of distance
    assert deviation[0, 0] == pytest.approx(np.sqrt(2 * 0.1**2 + 0.02**2 + 0.03**2 + 0.03**2))


@pytest.mark.parametrize("shape", [(WINDOW, WINDOW), (5, 40), (33, 6), (24, 37)])
@pytest.mark.parametrize("unknown", [0.0, 0.5, 0.98])
def test_surfaces_start_where_the_definition_says(shape, unknown, both_ways):
    rng = np.random.default_rng(shape)
    depth = 1 + 0.01 * rng.standard_normal(shape)
    depth[:, shape[1] // 2 :] += 0.4
    depth[rng.random(shape) < unknown] = np.nan
    deviation = rng.uniform(0.005, 0.02, shape)
    planes = depth.astype(np.float32), deviation.astype(np.float32)
    for compiled, defined in zip(*both_ways(inner_starts, *planes), strict=True):
        assert compiled.shape == tuple(size - WINDOW + 1 for size in shape)
        np.testing.assert_array_equal(compiled, defined)


@pytest.mark.parametrize("name", ["verdicts", "picture", "surface_starts"])
def test_buffers_that_do_not_fit_are_refused(name):
    kernel = backend.compiled("fit")
    if kernel is None:
        raise KernelError("the fixture promises a kernel")
    declared = {function.name: function for function in backend.KERNELS["fit"].interface.functions}
    with pytest.raises(ValueError, match=name):
        getattr(kernel, name)(*(np.zeros(8, np.uint8) for _ in declared[name].buffers))
