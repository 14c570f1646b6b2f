# SPDX-License-Identifier: Apache-2.0
"""napari without a screen: our plugin's layers, their names, colours and scales, and live ones."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
pytest.importorskip("napari", reason="other programs are not installed: extra 'napari'")
pytest.importorskip("qtpy", reason="other programs are not installed: extra 'napari'")

with warnings.catch_warnings():  # napari's own, of its dependencies
    warnings.simplefilter("ignore")
    import npe2
    from napari.components import ViewerModel
    from npe2 import PluginManager, PluginManifest

import hueflight as hf
from hueflight.client import ClientError
from hueflight.color.display import wavelength_colour
from hueflight.integrations.napari.live import show_live
from hueflight.integrations.napari.reader import read, reader_of
from support.daemon_process import Daemon, until

pytestmark = pytest.mark.filterwarnings("ignore")
PIXEL_UM = (73.6, 147.2)  #: height and width


@pytest.fixture(scope="module")
def manager() -> Iterator[PluginManager]:
    """npe2 with our manifest, which is read from its file."""
    made = PluginManager.instance()
    path = resources.files("hueflight.integrations.napari") / "napari.yaml"
    if "hueflight" in made:
        made.unregister("hueflight")
    made.register(PluginManifest.from_file(str(path)))
    yield made
    made.unregister("hueflight")


def opened(manager: PluginManager, path: Path) -> ViewerModel:
    """A viewer with the layers of a file, read through npe2 as napari does."""
    viewer = ViewerModel()
    for each in npe2.read([str(path)], stack=False, plugin_name="hueflight"):
        viewer._add_layer_from_data(*each)
    return viewer


def test_the_manifest_is_valid_and_its_commands_exist(manager: PluginManager) -> None:
    manifest = manager.get_manifest("hueflight")
    manifest.validate_imports()
    assert [reader.command for reader in manifest.contributions.readers] == ["hueflight.read"]
    readers = {each.command for each in manager.iter_compatible_readers("scene.ome.tif")}
    assert readers == {"hueflight.read"}


def test_an_image_has_depth_color_bands_and_points(
    manager: PluginManager, image_file: Path
) -> None:
    image = hf.read_image(image_file)
    viewer = opened(manager, image_file)
    layers = {layer.name: layer for layer in viewer.layers}
    assert np.array_equal(layers["depth"].data, image.depth.values, equal_nan=True)
    assert tuple(layers["depth"].scale) == PIXEL_UM
    assert layers["depth"].colormap.name == "turbo"
    low, high = layers["depth"].contrast_limits
    known = image.depth.values[np.isfinite(image.depth.values)]
    assert known.min() <= low < high <= known.max()
    assert layers["color"].rgb
    assert layers["color"].data.shape == (24, 16, 3)
    for number, (name, nm) in enumerate(
        zip(image.band_name.values, image.wavelength.values, strict=True)
    ):
        layer = layers[f"reflectance {name} {nm:g} nm"]
        wanted = image.reflectance.isel(band=number).transpose("row", "col").values
        assert np.array_equal(layer.data, wanted, equal_nan=True)
        assert layer.blending == "additive"
        assert layer.colormap.colors[-1, :3] == pytest.approx(wavelength_colour(nm), abs=1e-6)
    shown = {layer.name for layer in viewer.layers if layer.visible}
    assert shown == {"depth", "photons", "color"}
    points = layers["points"]
    assert len(points.data) == len(known)
    assert points.data[:, 0] == pytest.approx(known, rel=1e-6)
    assert {"quality", "row", "col"} <= {*points.features}


def test_an_ome_tiff_of_ours_keeps_names_and_colors(
    manager: PluginManager, image_file: Path, tmp_path: Path
) -> None:
    image = hf.read_image(image_file)
    path = tmp_path / "scene.ome.tif"
    hf.write_image(image, path)
    layers = {layer.name: layer for layer in opened(manager, path).layers}
    assert np.array_equal(layers["depth"].data, image.depth.values, equal_nan=True)
    assert layers["depth"].metadata["unit"] == "m"
    assert tuple(layers["depth"].scale) == PIXEL_UM
    red = layers["reflectance red 632 nm"]
    wanted = image.reflectance.isel(band=1).values
    assert np.array_equal(red.data, wanted, equal_nan=True)
    assert red.colormap.colors[-1, 0] == 1.0  # OME's colour of the channel: red
    assert red.colormap.colors[-1, 2] == 0.0


def test_other_files_are_left_to_other_readers(tmp_path: Path) -> None:
    import tifffile

    tifffile.imwrite(tmp_path / "other.ome.tif", np.zeros((4, 4), np.uint8), ome=True)
    (tmp_path / "broken.ome.tif").write_bytes(b"no TIFF")
    (tmp_path / "other.zarr").mkdir()
    for name in ("other.ome.tif", "broken.ome.tif", "other.zarr"):
        assert reader_of(str(tmp_path / name)) is None
    with pytest.raises(hf.HueflightError, match=r"other\.zarr"):
        read(str(tmp_path / "other.zarr"))


def test_a_recording_has_photons_and_with_a_calibration_an_image(
    manager: PluginManager, calibrated: Daemon, tmp_path: Path
) -> None:
    with hf.connect(calibrated.url) as camera:
        name = camera.record(frames=300)
        camera.wait_for_recording(name, timeout_s=60)
        path = camera.download(name, tmp_path)
        source = Path(camera.status()["calibration"]["path"])
    with hf.open_recording(path) as recording:
        histogram = recording.histogram()
    layers = {layer.name: layer for layer in opened(manager, path).layers}
    assert {*layers} == {"photons", "counts"}
    assert np.array_equal(layers["counts"].data, np.moveaxis(histogram, -1, 0))
    assert np.array_equal(layers["photons"].data, histogram[..., 1:].sum(-1))
    (tmp_path / "calibration.zarr").symlink_to(source)
    layers = {layer.name: layer for layer in opened(manager, path).layers}
    image = hf.reconstruct(histogram, hf.Calibration.load(source))
    assert np.array_equal(layers["depth"].data, image.depth.values, equal_nan=True)


def test_live_layers_follow_the_camera(calibrated: Daemon) -> None:
    """The layers in a Qt program without a window: it would need OpenGL."""
    from qtpy.QtWidgets import QApplication

    app = QApplication.instance() or QApplication([])
    viewer = ViewerModel()

    def after(number: int) -> bool:
        app.processEvents()
        assert live.failure is None
        return live.shown > number

    live = show_live(viewer, calibrated.url)
    try:
        until(lambda: after(0), "a picture")
        names = {layer.name for layer in viewer.layers}
        assert {"depth", "color", "reflectance red 632 nm", "quality"} <= names
        first, before = live.shown, viewer.layers["photons"].data
        until(lambda: after(first), "another one")
        assert {layer.name for layer in viewer.layers} == names
        assert not np.array_equal(viewer.layers["photons"].data, before)
    finally:
        live.stop()
    assert isinstance(live.failure, ClientError)  # the connection is closed
