# SPDX-License-Identifier: Apache-2.0
"""A scene from an instrument's point of view: depth, surface and illumination of every pixel.

Scenes consist of flat layers that face the camera. They are described in metres, so that any
instrument can be combined with any scene. The ray of each pixel is followed to the first layer
that it hits, and from there to each LED to find out whether another layer casts a shadow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import SceneError
from hueflight.model.instrument import Instrument
from hueflight.model.spectra import WAVELENGTH_NM, band_weights
from hueflight.simulator.effects.footprint import Rays

NOTHING = -1  #: surface index where a ray meets nothing

#: width of a highlight on satin print, metres per metre of distance
_GLOSS_SPREAD = 0.08

Paint = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.intp]]
Relief = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Layer:
    """A flat object that faces the camera.

    Attributes
    ----------
    depth_m : float
        Distance from the camera along its axis, m.
    paint : callable
        Maps positions right and down of the axis, m, to the index of the surface there;
        `NOTHING` where the layer has none.
    relief : callable or None
        Maps the same positions to the height of a rounded object above the layer, m.
    """

    depth_m: float
    paint: Paint
    relief: Relief | None = None


@dataclass(frozen=True)
class Truth:
    """What a perfect measurement would give.

    Attributes
    ----------
    depth : ndarray of float, shape (row, col)
        Depth along the optical axis, m; NaN where there is nothing.
    reflectance : ndarray of float, shape (band, row, col)
        Reflectance relative to a white surface, averaged over the band's light.
    shading : ndarray of float, shape (row, col)
        Brightness due to the tilt of the surface; 1 where it faces the camera.
    lit : ndarray of bool, shape (row, col)
        Whether every LED reaches the point; elsewhere there is a shadow.
    regions : mapping of str to ndarray of bool, shape (row, col)
        Mask of the lit part of each object.
    wavelengths_nm : ndarray of float, shape (band,)
        Peak wavelength of each band, nm.
    """

    depth: NDArray[np.float64]
    reflectance: NDArray[np.float64]
    shading: NDArray[np.float64]
    lit: NDArray[np.bool_]
    regions: Mapping[str, NDArray[np.bool_]]
    wavelengths_nm: NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """A scene from an instrument's point of view. Make it with `scene`.

    Attributes
    ----------
    name : str
        Name of the scene.
    depth : ndarray of float, shape (row, col)
        Depth along the optical axis, m; NaN where a ray meets nothing.
    incidence : ndarray of float, shape (row, col)
        Cosine of the angle between the surface's normal and the direction to the camera.
    surface : ndarray of int, shape (row, col)
        Index into `surfaces`; `NOTHING` (−1) where there is none.
    surfaces : tuple of str
        Names of the surfaces.
    spectra : ndarray of float, shape (surface, wavelength)
        Reflectance at `spectra.WAVELENGTH_NM`.
    light : ndarray of float, shape (band, row, col)
        Fraction of each LED's direct light that arrives; small in a shadow.
    glare : ndarray of float, shape (row, col)
        Specular reflection added to the reflectance, the same in all bands.
    regions : mapping of str to ndarray of bool, shape (row, col)
        Mask of each object.
    rays : Rays or None
        Directions in which the pixels look; None for the centres of the instrument's pixels.
    footprint : tuple of Scene
        The scene along each ray of the pixels' footprint, whose light is averaged; empty where a
        pixel sees along the ray through its centre only.
    moments : tuple of Scene
        The scene at equally spaced moments of a capture during which it moves; empty where it
        stands still.
    """

    name: str
    depth: NDArray[np.float64]
    incidence: NDArray[np.float64]
    surface: NDArray[np.intp]
    surfaces: tuple[str, ...]
    spectra: NDArray[np.float64]
    light: NDArray[np.float64]
    glare: NDArray[np.float64]
    regions: Mapping[str, NDArray[np.bool_]]
    rays: Rays | None = None
    footprint: tuple[Scene, ...] = ()
    moments: tuple[Scene, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.depth.shape[0], self.depth.shape[1]

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Whether the ray of each pixel meets a surface, shape (row, col)."""
        return self.surface != NOTHING

    def parts(self) -> tuple[Scene, ...]:
        """Return the scene along each ray and at each moment, whose light is averaged.

        Returns
        -------
        tuple of Scene
            Scenes of one ray per pixel that stand still; at least one.
        """
        return tuple(
            ray for moment in self.moments or (self,) for ray in moment.footprint or (moment,)
        )

    def require_fit(self, instrument: Instrument) -> None:
        """Check that the scene was laid out for the geometry of an instrument.

        Parameters
        ----------
        instrument : Instrument
            Instrument that looks at the scene.

        Raises
        ------
        SceneError
            If the number of bands, rows or columns differs.
        """
        expected = (len(instrument.bands), *instrument.image_shape)
        if self.light.shape != expected:
            raise SceneError(
                f"scene {self.name!r} was laid out for (band, row, col) = {self.light.shape} but "
                f"instrument {instrument.name!r} has {expected}: lay it out for that instrument"
            )

    def band_reflectance(self, instrument: Instrument) -> NDArray[np.float64]:
        """Mean reflectance, weighted by the spectrum of each band's light at the detector.

        Parameters
        ----------
        instrument : Instrument
            Instrument whose bands give the weights.

        Returns
        -------
        ndarray of float, shape (band, row, col)
            Mean reflectance; 0 where a ray meets nothing.
        """
        return self._spread(band_weights(instrument) @ self.spectra.T)

    def mean_reflectance(self, weights: NDArray[np.floating]) -> NDArray[np.float64]:
        """Mean reflectance under light of one spectrum.

        Parameters
        ----------
        weights : ndarray of float, shape (wavelength,)
            Spectrum of the light at `spectra.WAVELENGTH_NM`, normalized to sum 1.

        Returns
        -------
        ndarray of float, shape (row, col)
            Mean reflectance; 0 where a ray meets nothing.
        """
        return self._spread(weights[None] @ self.spectra.T)[0]

    def truth(self, instrument: Instrument) -> Truth:
        """Compute what a perfect measurement of the scene would give.

        Parameters
        ----------
        instrument : Instrument
            Instrument for which the scene was laid out.

        Returns
        -------
        Truth
            Depth, reflectance and regions; NaN where a ray meets nothing.

        Raises
        ------
        SceneError
            If the scene was laid out for another geometry.
        """
        self.require_fit(instrument)
        nothing = ~self.visible
        lit = np.all(self.light == 1, axis=0) & self.visible
        return Truth(
            depth=self.depth.copy(),
            reflectance=np.where(nothing, np.nan, self.band_reflectance(instrument)),
            shading=np.where(nothing, np.nan, self.incidence / instrument.ray_cosine()),
            lit=lit,
            regions={name: mask & lit for name, mask in self.regions.items()},
            wavelengths_nm=instrument.wavelengths_nm,
        )

    def _spread(self, of_surface: NDArray[np.float64]) -> NDArray[np.float64]:
        """Spread values per surface, (band, surface), over the pixels, (band, row, col).

        Pixels without a surface get 0.
        """
        # index −1 of pixels without a surface selects the appended column
        padded = np.concatenate([of_surface, np.zeros((of_surface.shape[0], 1))], axis=1)
        return padded[:, self.surface]


def moved(layer: Layer, displacement_m: tuple[float, float, float]) -> Layer:
    """Displace a layer.

    Parameters
    ----------
    layer : Layer
        Layer in its original position.
    displacement_m : tuple of float
        Metres to the right, down and away from the camera.

    Returns
    -------
    Layer
        The displaced layer.
    """
    right, down, away = displacement_m
    paint, relief = layer.paint, layer.relief
    return Layer(
        layer.depth_m + away,
        lambda x, y: paint(x - right, y - down),
        relief and (lambda x, y: relief(x - right, y - down)),
    )


def illuminator_positions(
    instrument: Instrument, center_m: tuple[float, float], ring_m: float
) -> NDArray[np.float64]:
    """Positions of the LEDs of a ring in the plane of the lens.

    Parameters
    ----------
    instrument : Instrument
        Instrument with one LED per band.
    center_m : tuple of float
        Center of the ring, metres right and down of the lens.
    ring_m : float
        Diameter of the ring, m.

    Returns
    -------
    ndarray of float, shape (band, 2)
        Position of each LED, metres right and down of the lens, clockwise from the right.
    """
    angle = 2 * np.pi * np.arange(len(instrument.bands)) / len(instrument.bands)
    return np.array(center_m) + ring_m / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def trace(
    name: str,
    layers: Sequence[Layer],
    instrument: Instrument,
    *,
    surfaces: Sequence[str],
    spectra: NDArray[np.float64],
    regions: Mapping[str, Sequence[str]],
    gloss: Mapping[str, float],
    leds_m: NDArray[np.float64],
    indirect: float,
    rays: Rays | None = None,
) -> Scene:
    """Trace the rays of an instrument to layers and onwards to its LEDs.

    Parameters
    ----------
    name : str
        Name of the scene.
    layers : sequence of Layer
        Objects of the scene, in any order.
    instrument : Instrument
        Instrument that looks at the scene.
    surfaces : sequence of str
        Names of the surfaces, at the indices that `Layer.paint` returns.
    spectra : ndarray of float, shape (surface, wavelength)
        Reflectance of each surface at `spectra.WAVELENGTH_NM`.
    regions : mapping of str to sequence of str
        Surfaces that belong to each named region.
    gloss : mapping of str to float
        Specular reflectance of glossy surfaces at its maximum.
    leds_m : ndarray of float, shape (band, 2)
        Position of each LED, metres right and down of the lens, from `illuminator_positions`.
    indirect : float
        Fraction of the light that reaches a shadow by way of other surfaces, 0 to 1.
    rays : Rays or None, default None
        Directions in which the pixels look; None for the centres of the instrument's pixels.

    Returns
    -------
    Scene
        Depth, surface and illumination of every pixel.

    Raises
    ------
    SceneError
        If `spectra` does not have one row for each surface.
    """
    if spectra.shape != (len(surfaces), WAVELENGTH_NM.size):
        raise SceneError(
            f"spectra have shape {spectra.shape}: give one row of {WAVELENGTH_NM.size} values "
            f"for each of the {len(surfaces)} surfaces"
        )
    right, down = instrument.ray_slopes() if rays is None else (rays.right, rays.down)
    shape = right.shape
    depth = np.full(shape, np.nan)
    incidence = instrument.ray_cosine().copy() if rays is None else rays.cosine
    surface = np.full(shape, NOTHING, dtype=np.intp)
    light = np.ones((len(instrument.bands), *shape))
    in_front: list[Layer] = []
    for layer in sorted(layers, key=lambda layer: layer.depth_m):
        x, y = right * layer.depth_m, down * layer.depth_m
        paint = layer.paint(x, y)
        hit = (paint != NOTHING) & (surface == NOTHING)
        surface[hit] = paint[hit]
        depth[hit] = layer.depth_m
        if layer.relief is not None:
            depth[hit] -= layer.relief(x[hit], y[hit])
            incidence[hit] *= _tilt(layer.relief, x[hit], y[hit], right[hit], down[hit])
        for front in in_front:
            for band, (led_x, led_y) in enumerate(leds_m):
                share = front.depth_m / layer.depth_m
                on_way = (
                    led_x + (x[hit] - led_x) * share,
                    led_y + (y[hit] - led_y) * share,
                )
                light[band, hit] *= np.where(front.paint(*on_way) == NOTHING, 1.0, indirect)
        in_front.append(layer)
    np.maximum(light, indirect, out=light)  # two obstacles make the shadow no darker than one
    # a mirror that faces the camera shows the LEDs at half their offset
    off_x, off_y = (
        slope * np.where(np.isnan(depth), 1, depth) - middle / 2
        for slope, middle in zip((right, down), leds_m.mean(axis=0), strict=True)
    )
    highlight = np.exp(-(off_x**2 + off_y**2) / (2 * (_GLOSS_SPREAD * depth) ** 2))
    height = np.array([gloss.get(member, 0.0) for member in surfaces] + [0.0])[surface]
    return Scene(
        name=name,
        depth=depth,
        incidence=incidence,
        surface=surface,
        surfaces=tuple(surfaces),
        spectra=spectra,
        light=light,
        glare=np.where(height > 0, height * highlight, 0.0),
        regions={
            region: np.isin(surface, [list(surfaces).index(member) for member in members])
            for region, members in regions.items()
        },
        rays=rays,
    )


def _tilt(
    relief: Relief,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    right: NDArray[np.float64],
    down: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Cosine of incidence at points of a relief, divided by that of the flat layer.

    `x` and `y` are the positions on the layer, m, and `right` and `down` the slopes of the rays to
    them, all of shape (point,).
    """
    step = 2e-4
    slope_x = (relief(x + step, y) - relief(x - step, y)) / (2 * step)
    slope_y = (relief(x, y + step) - relief(x, y - step)) / (2 * step)
    # the normal is −(slope_x, slope_y, 1), the direction to the camera −(right, down, 1)
    facing = 1 + slope_x * right + slope_y * down
    return np.maximum(facing, 0) / np.sqrt(1 + slope_x**2 + slope_y**2)
