# SPDX-License-Identifier: Apache-2.0
"""The page of a file: complete in itself, and the fit in it is that of the calibration."""

import base64
import json
import re
import zlib

import numpy as np
import pytest

import hueflight as hf
from hueflight.daemon.viewer import viewer_page
from hueflight.errors import HueflightError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from support.browser import open_browser

ROWS, COLS = 6, 8


@pytest.fixture(scope="module")
def camera(small):
    return small(rows=ROWS, cols=COLS)


@pytest.fixture(scope="module")
def calibration(camera, draw):
    return hf.calibrate(draw(camera, depth=0.4, photons=50_000), camera, distance=0.4)


@pytest.fixture(scope="module")
def counts(camera, draw):
    return draw(camera, depth=0.7, photons=9000, background=300, seed=1)


@pytest.fixture(scope="module")
def image(counts, calibration):
    return hf.reconstruct(counts, calibration)


def parts(page):
    meta = json.loads(re.search(r'id="meta">(.*?)</script>', page)[1])
    raw = zlib.decompress(base64.b64decode(re.search(r'id="data">(.*?)</script>', page)[1]))
    planes = {
        one["name"]: np.frombuffer(raw, one["type"], one["length"], one["offset"])
        for one in meta["planes"]
    }
    return meta, planes


def expected_fit(image, calibration, row, col):
    """Counts of a pixel's fit, from the calibration itself."""
    here = image.isel(row=row, col=col)
    cosine = calibration.instrument.ray_cosine()[row, col]
    delay = 2 * (float(here.depth) - calibration.distance) / cosine / SPEED_OF_LIGHT_M_PER_NS
    delay += calibration.pixel_delay_ns[row, col]
    light = here.reflectance.values * float(here.white_photons) * here.white_share.values
    bins = calibration.bins
    floor = float(here.background) * bins.widths_ns / (bins.span_ns / bins.count)
    return floor + light @ calibration.templates.shares(bins.edges_ns, delay)


def test_the_page_holds_the_image_and_the_counts(camera, calibration, counts, image):
    page = viewer_page(
        title="</script><b>", instrument=camera, image=image, histogram=counts,
        calibration=calibration,
    )  # fmt: skip
    assert "<b>" not in page
    assert not re.search(r'(src|href)="(?!#)', page)  # nothing is loaded from elsewhere
    meta, planes = parts(page)
    assert (meta["rows"], meta["cols"]) == (ROWS, COLS)
    np.testing.assert_array_equal(planes["depth"], image.depth.values.ravel())
    cube = np.moveaxis(image.reflectance.values, -1, 0)
    np.testing.assert_array_equal(planes["reflectance"], cube.ravel())
    ordered = calibration.bins.in_time_order(counts)
    np.testing.assert_array_equal(planes["counts"], ordered.ravel())
    names = [name for name, _ in meta["views"]]
    assert {"depth", "colour", "depth_std", "quality", "points", "photons", "band 8"} <= set(names)


def test_parts_alone(camera, counts, image):
    meta, planes = parts(viewer_page(title="x", instrument=camera, histogram=counts))
    assert [name for name, _ in meta["views"]] == ["photons"]
    assert planes["photons"].reshape(ROWS, COLS)[tuple(meta["pixel"])] == planes["photons"].max()
    meta, planes = parts(viewer_page(title="x", instrument=camera, image=image))
    assert meta["model"] is None
    assert "counts" not in planes
    with pytest.raises(HueflightError, match="neither"):
        viewer_page(title="x", instrument=camera)
    with pytest.raises(HueflightError, match="series"):
        viewer_page(title="x", instrument=camera, image=hf.analysis.stack([image, image]))


def test_in_a_browser(tmp_path, camera, calibration, counts, image):
    page = viewer_page(
        title="scene", instrument=camera, image=image, histogram=counts, calibration=calibration
    )
    file = tmp_path / "page.html"
    file.write_text(page, encoding="utf-8")
    folder = tmp_path / "profile"
    folder.mkdir()
    with open_browser(folder) as browser:
        shown = browser.new_page()
        problems = []
        shown.on("pageerror", lambda error: problems.append(str(error)))
        shown.goto(file.as_uri())
        shown.wait_for_function("window.viewer !== undefined")
        assert shown.locator("#problem").is_hidden()
        found = shown.evaluate("viewer.facts(2, 3)")
        model = expected_fit(image, calibration, 2, 3)
        # a table of 4096 steps, straight in between; 9000 photons
        np.testing.assert_allclose(found["model"], model, atol=0.01 * model.max())
        assert sum(found["counts"]) == int(image.photons[2, 3])
        for name, _ in parts(page)[0]["views"]:
            shown.evaluate(f"viewer.select({name!r})")
            shown.evaluate("viewer.choose(2, 3)")
            lit = shown.evaluate(
                "(() => { const c = document.getElementById('plane');"
                "return new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data)"
                ".size; })()"
            )
            assert lit > 1
        assert "row 2, column 3" in shown.inner_text("h2")
        assert f"{float(image.depth[2, 3]):.4f} m" in shown.inner_text(".figure")
        assert problems == []
