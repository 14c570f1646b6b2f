# SPDX-License-Identifier: Apache-2.0
"""Scenes: what lies where, what is lit, and that any instrument sees the same thing."""

import numpy as np
import pytest

from hueflight import Instrument
from hueflight.color.color_chart import PATCHES, patch_reflectances
from hueflight.errors import SceneError
from hueflight.model.spectra import band_weights
from hueflight.simulator import NOTHING, SCENES, scene, scenes
from hueflight.simulator.scene import Layer, trace
from hueflight.simulator.scene_layout import SurfaceTable


@pytest.fixture(scope="module")
def fig1(paper):
    return scene("fig1", paper)


def test_every_scene_has_a_line_and_fits_every_preset(resized):
    assert set(scenes()) == set(SCENES)
    for preset in Instrument.presets():
        instrument = Instrument.load(preset)
        if instrument.image_shape[0] > 200:
            instrument = resized(instrument, 64, 64)
        for name, line in scenes().items():
            assert line
            assert "\n" not in line
            view = scene(name, instrument)
            assert view.shape == instrument.image_shape
            assert view.light.shape == (len(instrument.bands), *instrument.image_shape)
            truth = view.truth(instrument)
            assert np.array_equal(np.isnan(truth.depth), view.surface == NOTHING)


def test_fig1_has_the_papers_distances_and_colours(fig1, paper):
    truth = fig1.truth(paper)
    depth = np.unique(np.round(truth.depth, 2))
    assert set(depth) == {0.70, 0.80, 1.00}  # the horse's rounding stays within 5 mm of 0.70
    assert set(truth.regions) == {
        "red brick", "green brick", "blue brick", "purple brick",
        "horse", "saddle", "background", "logos",
    }  # fmt: skip
    for name, distance in (("background", 1.0), ("green brick", 0.8), ("horse", 0.7)):
        assert truth.depth[truth.regions[name]].mean() == pytest.approx(distance, abs=0.005)
        assert truth.regions[name].sum() > 300
    # spectra of different things differ
    spectra = np.array([truth.reflectance[:, mask].mean(axis=1) for mask in truth.regions.values()])
    apart = np.abs(spectra[:, None] - spectra[None]).max(axis=-1)
    assert (apart[~np.eye(len(spectra), dtype=bool)] > 0.08).all()


def test_fig1_rows_of_the_papers_fig6(fig1, paper):
    truth = fig1.truth(paper)
    # row 139: plain board, lit, one colour
    assert truth.regions["background"][139].all()
    # row 56: board through the window, wall, board, horse
    changes = truth.depth[56][np.append(True, np.abs(np.diff(truth.depth[56])) > 0.05)]
    assert list(np.round(changes, 1)[:5]) == [0.8, 1.0, 0.8, 1.0, 0.7]
    # shadows lie in the window and left of the horse, where the paper's do to some columns
    dark = np.flatnonzero(fig1.light[4, 56] < 1)
    window, beside = dark[dark < 30], dark[(dark > 30) & (dark < 60)]
    assert abs(window.mean() - 13) < 4
    assert abs(beside.mean() - 50) < 4


@pytest.mark.parametrize("distance", [0.5, 1.0, 1.5])
def test_fig7_has_wall_and_board_ten_centimetres_off(paper, distance):
    depth = scene("fig7", paper, distance=distance).depth
    np.testing.assert_allclose(np.unique(depth), [distance - 0.1, distance + 0.1])
    assert 0.2 < (depth < distance).mean() < 0.8


def test_nearer_walls_shade_more_of_the_window(paper):
    # Fig. 7: at 0.5 m a larger area within the window is in shadow
    def shaded_columns(distance):
        return (scene("fig7", paper, distance=distance).light[4, 96] < 1).sum()

    assert shaded_columns(0.5) > 2 * shaded_columns(1.0) > 2 * shaded_columns(1.5) > 0


def test_shadow_of_an_edge_lies_where_similar_triangles_put_it(paper, resized):
    # half plane at 0.5 m left of x = 0, wall at 1 m, one LED at x = +0.1 m: the shadow ends at
    # 0.1 + (0 − 0.1)·(1/0.5) = −0.1 m on the wall
    instrument = resized(paper, 4, 1024, pixel_width_um=2.3)
    palette = SurfaceTable()
    grey = palette["grey"]
    layers = (
        Layer(0.5, lambda x, _y: np.where(x < -1e-9, grey, NOTHING)),
        Layer(1.0, lambda x, _y: np.full(x.shape, grey)),
    )

    def lit(led_x):
        return trace(
            "edge", layers, instrument, surfaces=tuple(palette.spectra), spectra=palette.table(),
            regions={}, gloss={}, leds_m=np.tile([led_x, 0.0], (9, 1)), indirect=0.25,
        ).light[0, 0]  # fmt: skip

    x_wall = instrument.ray_slopes()[0][0] * 1.0
    assert (lit(0.1)[x_wall >= 0] == 1).all()  # shadow −0.1 … hidden behind the half plane itself
    # LED on the left: shadow reaches x = +0.1 on the wall
    light = lit(-0.1)
    seen = x_wall >= 0
    np.testing.assert_array_equal(light[seen] < 1, x_wall[seen] < 0.1)
    assert set(light) == {0.25, 1.0}


def test_no_offset_no_shadow(paper):
    view = scene("fig1", paper, illuminator_m=(0.0, 0.0), ring_m=0.0)
    # rays from the lens itself reach all that the lens sees
    assert (view.light == 1).all()


def test_leds_of_the_ring_throw_shadows_of_their_own(fig1, paper):
    partly = (fig1.light < 1).any(axis=0) & (fig1.light == 1).any(axis=0)
    assert 0 < partly.mean() < 0.1
    assert not fig1.truth(paper).lit[partly].any()


def test_instruments_of_other_geometry_see_the_same_scene(paper, resized):
    # twice the pixels at half the pitch: every second pair straddles a pixel of the coarse one
    fine = resized(paper, 576, 384, pixel_width_um=18.4 / 3, pixel_height_um=9.2 / 3)
    for name in ("fig1", "colorchecker"):
        coarse, thrice = scene(name, paper), scene(name, fine)
        np.testing.assert_array_equal(coarse.surface, thrice.surface[1::3, 1::3])
        np.testing.assert_allclose(coarse.depth, thrice.depth[1::3, 1::3])


def test_colorchecker_shows_its_patches(paper):
    truth = scene("colorchecker", paper).truth(paper)
    assert list(truth.regions) == list(PATCHES)
    wanted = patch_reflectances() @ band_weights(paper).T
    for patch, (name, mask) in enumerate(truth.regions.items()):
        assert mask.sum() > 400, name
        np.testing.assert_allclose(
            truth.reflectance[:, mask], wanted[patch][:, None].repeat(mask.sum(), axis=1)
        )
    # reading order: dark skin top left, black bottom right
    rows, cols = np.nonzero(truth.regions["dark skin"])
    assert (rows.mean(), cols.mean()) < (60, 30)
    rows, cols = np.nonzero(truth.regions["black"])
    assert rows.mean() > 130
    assert cols.mean() > 100


def test_staircase_climbs(paper):
    truth = scene("staircase", paper, near=0.5, far=1.2, steps=5).truth(paper)
    depths = [truth.depth[mask] for mask in truth.regions.values()]
    for depth, wanted in zip(depths, np.linspace(0.5, 1.2, 5), strict=True):
        np.testing.assert_allclose(depth, wanted)
        assert depth.size > 3000


def test_plane_and_empty(paper):
    truth = scene("plane", paper, distance=2.5, surface=0.4).truth(paper)
    np.testing.assert_array_equal(truth.depth, 2.5)
    np.testing.assert_allclose(truth.reflectance, 0.4)
    np.testing.assert_allclose(truth.shading, 1)
    assert truth.lit.all()
    nothing = scene("empty", paper).truth(paper)
    assert np.isnan(nothing.depth).all()
    assert np.isnan(nothing.reflectance).all()
    assert not nothing.lit.any()


def test_rounded_horse_is_shaded_at_its_rim(fig1, paper):
    truth = fig1.truth(paper)
    horse = truth.regions["horse"]
    assert truth.shading[horse].min() < 0.9
    assert np.median(truth.shading[horse]) > 0.95
    assert np.ptp(truth.depth[horse]) > 0.0015
    flat = truth.regions["background"]
    np.testing.assert_allclose(truth.shading[flat], 1)


def test_glare_is_on_the_print_and_nearest_the_mirror_point(paper):
    view = scene("fig1", paper, glare=0.5)
    logos = view.regions["logos"]
    assert (view.glare[logos] > 0).all()
    assert not view.glare[~logos].any()
    assert view.glare.max() <= 0.5
    # truth knows nothing of it
    plain = scene("fig1", paper)
    assert not plain.glare.any()
    np.testing.assert_array_equal(view.truth(paper).reflectance, plain.truth(paper).reflectance)


def test_what_cannot_be_is_named(paper, one_pixel):
    with pytest.raises(SceneError, match=r"no scene 'fig2': there are fig1, fig7"):
        scene("fig2", paper)
    with pytest.raises(
        SceneError, match=r"'plane' has no option 'dist'; it has: distance, surface"
    ):
        scene("plane", paper, dist=1.0)
    with pytest.raises(SceneError, match=r"'empty' has no option 'distance'; it has: none"):
        scene("empty", paper, distance=1.0)
    for distance in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(SceneError, match="distances must be positive"):
            scene("plane", paper, distance=distance)
    with pytest.raises(SceneError, match="an object is at 0 m"):
        scene("fig7", paper, distance=0.1)
    with pytest.raises(SceneError, match="steps = 0"):
        scene("staircase", paper, steps=0)
    with pytest.raises(SceneError, match="must be greater than near"):
        scene("staircase", paper, near=1.0, far=0.5)
    with pytest.raises(SceneError, match=r"indirect = 1\.5"):
        scene("plane", paper, indirect=1.5)
    with pytest.raises(SceneError, match="lay it out for that instrument"):
        scene("plane", paper).truth(one_pixel)
