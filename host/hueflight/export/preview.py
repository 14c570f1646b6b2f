# SPDX-License-Identifier: Apache-2.0
"""PNG previews: a plane of an image as a picture with colour bar, unit and limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.color import color_picture
from hueflight.color.colormap import NO_DATA, colours
from hueflight.color.display import three_band_rgb
from hueflight.errors import ExportError
from hueflight.export.description import band_labels, plain_attributes
from hueflight.files import import_optional, staged
from hueflight.files.bands import find_band
from hueflight.files.image_schema import SERIES_DIM, require_image

MARGIN = 12
BAR_WIDTH = 18
TEXT_HEIGHT = 13
LABEL_WIDTH = 76
WANTED_SIDE = 480  #: small images are enlarged by integer factors towards this many pixels
BACKGROUND = (255, 255, 255)
INK = (32, 32, 32)
TICKS = 5

LARGEST_MM = 2**16 - 1  #: of a 16-bit depth


def write_png(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    variable: str = "depth",
    band: str | int | None = None,
    limits: tuple[float, float] | None = None,
    overwrite: bool = False,
) -> None:
    """Write one plane of an image as a PNG picture.

    Pixels are enlarged by an integer factor without smoothing; pixels without a value are grey.
    Limits, unit and metadata are also stored in the text entries of the file.

    Parameters
    ----------
    image : xarray.Dataset
        One image.
    path : str or pathlib.Path
        Name of the file.
    variable : str
        Name of the variable; ``"rgb"`` for colours from all bands (from three bands if the image
        does not describe its instrument), ``"three-band"`` for the false-colour picture of the
        paper.
    band : str or int, optional
        Name, number or wavelength (``"532 nm"``) of the band, for variables with one plane per
        band.
    limits : tuple of float, optional
        Values at the ends of the colour bar; by default the percentiles 1 and 99.
    overwrite : bool
        Whether an existing file of this name may be replaced.

    Raises
    ------
    ImageError
        If it is not an image.
    ExportError
        If the format can't hold the image.
    OutputError
        If the file exists already or can't be written.
    """
    picture, entries = _picture(image, variable, band, limits)
    png = import_optional("PIL.PngImagePlugin", extra="export")
    info = png.PngInfo()
    for key, value in {**plain_attributes(image), **entries}.items():
        info.add_itxt(key, value)
    with staged(path, overwrite=overwrite) as partial:
        picture.save(partial, format="PNG", pnginfo=info)


def write_depth_png(image: xr.Dataset, path: str | Path, /, *, overwrite: bool = False) -> None:
    """Write depth as a 16-bit gray PNG in millimetres, as depth cameras do; 0 is unknown.

    Parameters
    ----------
    image : xarray.Dataset
        One image.
    path : str or pathlib.Path
        Name of the file.
    overwrite : bool
        Whether an existing file of this name may be replaced.

    Raises
    ------
    ImageError
        If it is not an image.
    ExportError
        If the image is a series, or a depth does not lie between 0 and 65.5 m.
    OutputError
        If the file exists already or can't be written.
    """
    require_image(image)
    if SERIES_DIM in image.dims:
        raise ExportError(f"a picture shows one image: select one {SERIES_DIM!r} of the series")
    depth = image["depth"].transpose("row", "col").values.astype(np.float64)
    known = np.isfinite(depth)
    millimetres = np.rint(1e3 * depth[known])
    if ((millimetres < 1) | (millimetres > LARGEST_MM)).any():
        raise ExportError(
            f"depths from {depth[known].min():.3f} to {depth[known].max():.3f} m: 16 bits hold "
            f"1 mm to {LARGEST_MM / 1e3:.1f} m; write a .tif with variable='depth' instead"
        )
    pixels = np.zeros(depth.shape, np.uint16)
    pixels[known] = millimetres
    pillow = import_optional("PIL.Image", extra="export")
    png = import_optional("PIL.PngImagePlugin", extra="export")
    info = png.PngInfo()
    for key, value in {**plain_attributes(image), "unit": "mm", "unknown": "0"}.items():
        info.add_itxt(key, value)
    with staged(path, overwrite=overwrite) as partial:
        pillow.fromarray(pixels).save(partial, format="PNG", pnginfo=info)


def write_previews(image: xr.Dataset, folder: str | Path, /, *, overwrite: bool = False) -> None:
    """Write a folder of pictures: RGB, depth, its uncertainty, photons and every band.

    Parameters
    ----------
    image : xarray.Dataset
        One image.
    folder : str or pathlib.Path
        Name of the folder.
    overwrite : bool
        Whether an existing folder of this name may be replaced.

    Raises
    ------
    ImageError
        If it is not an image.
    ExportError
        If the format can't hold the image.
    OutputError
        If the file exists already or can't be written.
    """
    require_image(image)
    planes = [name for name in ("depth", "depth_std", "photons", "background") if name in image]
    wanted: list[tuple[str, str, int | None]] = [(name, name, None) for name in ("rgb", *planes)]
    labels = enumerate(band_labels(image))
    wanted += [(f"reflectance-{label}", "reflectance", band) for band, label in labels]
    with staged(folder, overwrite=overwrite) as partial:
        partial.mkdir()
        for stem, variable, band in wanted:
            write_png(image, partial / f"{stem}.png", variable=variable, band=band)


def _picture(
    image: xr.Dataset,
    variable: str,
    band: str | int | None,
    limits: tuple[float, float] | None,
) -> tuple[Any, dict[str, str]]:
    """Return the picture (a Pillow image) and the text entries that describe it."""
    require_image(image)
    if SERIES_DIM in image.dims:
        raise ExportError(f"a picture shows one image: select one {SERIES_DIM!r} of the series")
    if variable in ("rgb", "three-band"):
        all_bands = variable == "rgb" and "instrument_description" in image.attrs
        colour = color_picture(image) if all_bands else three_band_rgb(image)
        pixels = np.rint(colour * 255).astype(np.uint8)
        return _enlarged(pixels), {"variable": "rgb" if all_bands else "three-band"}
    plane = _plane(image, variable, band)
    low, high = limits or _percentiles(plane)
    if not (np.isfinite([low, high]).all() and low < high):
        raise ExportError(f"limits = {(low, high)!r}: the first must be below the second")
    unit = str(image[variable].attrs.get("units", "1"))
    title = variable if unit == "1" else f"{variable} [{unit}]"
    if band is not None:
        title = f"{title}, {image['wavelength'].values[find_band(image, band)]:g} nm"
    entries = {"variable": title, "limits": f"{low:.9g} {high:.9g}"}
    return _with_bar(colours(plane, low, high), title, low, high), entries


def _plane(image: xr.Dataset, variable: str, band: str | int | None) -> NDArray[np.float64]:
    if variable not in image.data_vars:
        raise ExportError(
            f"the image has no {variable!r}: choose rgb, three-band or one of "
            f"{', '.join(map(str, image.data_vars))}"
        )
    values = image[variable]
    if "band" in values.dims:
        count = image.sizes["band"]
        if band is None:
            raise ExportError(f"{variable!r} has {count} bands: say which, such as band='532 nm'")
        values = values.isel(band=find_band(image, band))
    elif band is not None:
        raise ExportError(f"{variable!r} has no bands: leave band={band!r} out")
    return values.transpose("row", "col").values.astype(np.float64)


def _percentiles(plane: NDArray[np.float64]) -> tuple[float, float]:
    known = plane[np.isfinite(plane)]
    if not known.size:
        return 0.0, 1.0  # a plane without values is all grey
    low, high = (float(v) for v in np.percentile(known, (1, 99)))
    return (low, high) if low < high else (low - 0.5, low + 0.5)


def _enlarged(pixels: NDArray[np.uint8]) -> Any:
    pil = import_optional("PIL.Image", extra="export")
    factor = max(1, WANTED_SIDE // max(pixels.shape[:2]))
    return pil.fromarray(pixels.repeat(factor, axis=0).repeat(factor, axis=1))


def _with_bar(pixels: NDArray[np.uint8], title: str, low: float, high: float) -> Any:
    """Return the picture with a title above and a colour bar on the right."""
    pil, draw_module = (
        import_optional("PIL.Image", extra="export"),
        import_optional("PIL.ImageDraw", extra="export"),
    )
    font = import_optional("PIL.ImageFont", extra="export").load_default(TEXT_HEIGHT)
    shown = _enlarged(pixels)
    top = MARGIN + TEXT_HEIGHT + 8
    height = max(shown.height, 128)
    canvas = pil.new(
        "RGB",
        (
            max(shown.width, 160) + BAR_WIDTH + LABEL_WIDTH + 3 * MARGIN,
            height + top + MARGIN + TEXT_HEIGHT,
        ),
        BACKGROUND,
    )
    canvas.paste(shown, (MARGIN, top))
    draw = draw_module.Draw(canvas)
    draw.text((MARGIN, MARGIN - 2), title, fill=INK, font=font)
    left = max(shown.width, 160) + 2 * MARGIN
    share = np.linspace(1, 0, height)[:, None].repeat(BAR_WIDTH, axis=1)
    canvas.paste(pil.fromarray(colours(share, 0, 1)), (left, top))
    for step in range(TICKS):
        y = top + round((height - 1) * step / (TICKS - 1))
        value = high + (low - high) * step / (TICKS - 1)
        draw.line((left + BAR_WIDTH, y, left + BAR_WIDTH + 4, y), fill=INK)
        label = f"{value:.4g}".replace("-", "−")
        draw.text((left + BAR_WIDTH + 7, y), label, fill=INK, font=font, anchor="lm")
    legend = top + height + 6
    draw.rectangle((MARGIN, legend, MARGIN + 9, legend + 9), fill=NO_DATA)
    draw.text((MARGIN + 15, legend + 5), "no value", fill=INK, font=font, anchor="lm")
    return canvas
