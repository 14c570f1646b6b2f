# SPDX-License-Identifier: Apache-2.0
"""Methods are found by name; a new one needs an object and a line."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.errors import HistogramError, HueflightError
from hueflight.model.background_shape import BackgroundShape
from hueflight.reconstruction import methods
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.options import BINDING_OPTIONS, EstimatorOptions
from hueflight.reconstruction.quality import Quality


class Toy:
    """Everything is at the distance of the reference and as bright as it has photons."""

    honors = frozenset({"pileup_correction"})

    def estimate(self, prepared, calibration, options, /):
        self.options = options
        shape = prepared.photons.shape
        bands = (len(calibration.instrument.bands), 1, 1)
        return Estimates(
            depth=np.full(shape, calibration.distance),
            depth_std=np.ones(shape),
            reflectance=np.tile(prepared.photons, bands),
            reflectance_std=np.ones((bands[0], *shape)),
            background=np.zeros(shape),
            photons=prepared.photons,
            quality=np.zeros(shape, np.uint16),
        )


@pytest.fixture(scope="module")
def setting(small, draw):
    instrument = small(rows=4, cols=5)
    calibration = hf.calibrate(draw(instrument, photons=20_000), instrument, distance=0.5)
    return calibration, draw(instrument, depth=0.9, photons=620)


@pytest.fixture
def registry(monkeypatch):
    """The registry, as it was after the test."""
    monkeypatch.setattr(methods, "METHODS", dict(methods.METHODS))


@pytest.mark.usefixtures("registry")
def test_a_method_of_ones_own(setting):
    calibration, counts = setting
    toy = Toy()
    methods.register("toy", toy)
    image = hf.reconstruct(
        counts, calibration, method="toy", region=np.s_[1:3, :], pileup_correction=False, threads=3
    )
    assert image.attrs["method"] == "toy"
    assert (image["depth"].values[1:3] == 0.5).all()
    assert np.isnan(image["depth"].values[0]).all()
    assert (image["quality"].values[0] == int(Quality.SKIPPED)).all()
    assert toy.options.threads == 3
    assert not toy.options.pileup_correction
    with pytest.raises(HueflightError, match="there is a method 'toy' already"):
        methods.register("toy", toy)


@pytest.mark.usefixtures("registry")
@pytest.mark.parametrize(
    "option", [{"depth_range": (0.2, 1.0)}, {"range_correction": True}], ids=lambda o: next(iter(o))
)
def test_an_option_that_a_method_ignores_is_refused(setting, option):
    calibration, counts = setting
    methods.register("toy", Toy())
    (name,) = option
    with pytest.raises(HueflightError, match=rf"{name} = .*method 'toy' .*method='joint'"):
        hf.reconstruct(counts, calibration, method="toy", **option)


@pytest.mark.usefixtures("registry")
def test_a_method_of_another_package(setting, monkeypatch):
    calibration, counts = setting
    entry = SimpleNamespace(load=Toy)

    def entry_points(*, group, name):
        return [entry] if (group, name) == ("hueflight.methods", "elsewhere") else []

    monkeypatch.setattr(methods, "entry_points", entry_points)
    assert hf.reconstruct(counts, calibration, method="elsewhere").attrs["method"] == "elsewhere"
    with pytest.raises(HistogramError, match="method = 'nowhere': choose one of joint, paper"):
        hf.reconstruct(counts, calibration, method="nowhere")


@pytest.mark.parametrize("method", methods.METHODS)
def test_the_shape_of_the_background_changes_an_image_or_is_refused(setting, draw, method):
    calibration, _ = setting
    counts = draw(calibration.instrument, photons=60, background=60)
    plain = hf.reconstruct(counts, calibration, method=method, range_correction=False)
    shape = BackgroundShape(slope=0.9)
    if method != "joint":
        with pytest.raises(HueflightError, match=rf"background = .*method {method!r}"):
            hf.reconstruct(counts, calibration, method=method, background=shape)
        return
    shaped = hf.reconstruct(
        counts, calibration, method=method, range_correction=False, background=shape
    )
    assert not np.array_equal(shaped.reflectance, plain.reflectance, equal_nan=True)


def test_methods_state_options_that_exist():
    for method in methods.METHODS.values():
        assert method.honors <= BINDING_OPTIONS <= set(EstimatorOptions.__dataclass_fields__)


def test_the_earlier_name_of_a_flag():
    assert Quality.STARVED is Quality.LOW_SIGNAL
    assert "STARVED" not in [flag.name for flag in Quality]


def test_images_of_a_calibration_share_neither_values_nor_labels(setting):
    calibration, counts = setting
    before = hf.reconstruct(counts, calibration)
    kept = before.copy(deep=True)
    changed = hf.reconstruct(counts, calibration)
    for variable in changed.variables.values():
        variable.attrs["units"] = "none"
    for name in ("depth", "reflectance", "wavelength", "white_photons", "white_share"):
        changed[name].values[:] = 7
    changed.attrs["method"] = "none"
    xr.testing.assert_identical(before, kept)
    xr.testing.assert_identical(hf.reconstruct(counts, calibration), kept)
