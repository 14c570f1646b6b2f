# SPDX-License-Identifier: Apache-2.0
"""Scores of departures that all pixels of a picture share.

A departure, such as a later LED, changes the expected counts of every pixel along a *direction*.
One pixel hardly sees it; the sum over pixels does. The scores are *efficient* (C(α) tests; Neyman,
in Probability and Statistics, 1959): from each direction everything is removed that the pixel's
own delay, amplitudes and background can explain. What those parameters take over is the bias that
the departure leaves in the pixel's result, and is a by-product.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.model.background_shape import BackgroundShape
from hueflight.model.waveform_changes import changed, drawn_out
from hueflight.model.waveforms import Templates

CHUNK_PIXELS = 512  #: pixels that are worked on at a time
LEAST_BACKGROUND = 0.5  #: photons of background in the weights, at least
RIDGE = 1e-6  #: on the unit diagonal of the normal equations
WIDTH_STEP = 0.01  #: relative change of pulse width whose difference gives the derivative

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FittedPixels:
    """Pixels, their counts and what a fit of one surface found.

    Attributes
    ----------
    counts : ndarray of float, shape (pixel, bin)
        Counts at the bins of the scores.
    arrival_ns : ndarray of float, shape (pixel,)
        Delay against the reference, with the pixel's own, ns.
    offset_ns : ndarray of float, shape (pixel,)
        The pixel's own delay, ns.
    amplitudes : ndarray of float, shape (pixel, band)
        Photons of each band, 0 or more.
    background : ndarray of float, shape (pixel,)
        Photons of background over all bins.
    """

    counts: _Floats
    arrival_ns: _Floats
    offset_ns: _Floats
    amplitudes: _Floats
    background: _Floats

    def take(self, chosen: NDArray[np.intp]) -> FittedPixels:
        """Return some of the pixels.

        Parameters
        ----------
        chosen : ndarray of int
            Their numbers.

        Returns
        -------
        FittedPixels
            These pixels.
        """
        return FittedPixels(
            self.counts[chosen],
            self.arrival_ns[chosen],
            self.offset_ns[chosen],
            self.amplitudes[chosen],
            self.background[chosen],
        )


@dataclass(frozen=True, eq=False)
class SharedModel:
    """Model of the counts, and the directions of the departures.

    The directions are, in this order: delay of each band (per ns), width of each band (relative),
    slope of the background, share of light through each exponential delay, share of the
    background that decays with each time constant, and lens flare at each delay, relative to the
    mean light of the pixels.

    Attributes
    ----------
    edges_ns : ndarray of float, shape (bin + 1,)
        Edges of the bins of the scores, ns.
    templates : Templates
        Waveforms of the calibration.
    background : BackgroundShape
        Shape of the background in the fit.
    step_ns : float
        Delays are rounded to multiples of this, ns.
    tails_ns, decays_ns, flares_ns : tuple of float
        Mean delays of exponential tails, time constants of a decaying background, and delays of
        the flare after the mean arrival of light, ns.
    """

    edges_ns: _Floats
    templates: Templates
    background: BackgroundShape
    step_ns: float
    tails_ns: tuple[float, ...]
    decays_ns: tuple[float, ...]
    flares_ns: tuple[float, ...]

    @property
    def directions(self) -> int:
        """Number of directions."""
        others = len(self.tails_ns) + len(self.decays_ns) + len(self.flares_ns)
        return 2 * self.templates.bands + 1 + others


@dataclass(frozen=True, eq=False)
class SharedScores:
    """Sums over pixels.

    Attributes
    ----------
    score : ndarray of float, shape (direction,)
        Efficient score of each direction.
    information : ndarray of float, shape (direction, direction)
        Its variance: the information about the sizes of the departures.
    """

    score: _Floats
    information: _Floats


def sum_scores(pixels: FittedPixels, model: SharedModel) -> SharedScores:
    """Sum the efficient scores over pixels.

    Parameters
    ----------
    pixels : FittedPixels
        Pixels with one surface each.
    model : SharedModel
        The model that was fitted, and the directions.

    Returns
    -------
    SharedScores
        Score and information.
    """
    score = np.zeros(model.directions)
    information = np.zeros((model.directions, model.directions))
    for _, nuisance, directions, residual in _chunks(pixels, model):
        inverse, mixed = _projection(nuisance, directions)
        # residual and directions without what the nuisance parameters explain
        step = inverse @ mixed
        left = directions - step.transpose(0, 2, 1) @ nuisance
        score += np.einsum("pmi,pi->m", left, residual)
        flat = left.transpose(1, 0, 2).reshape(model.directions, -1)
        information += flat @ flat.T
    return SharedScores(score, information)


def bias_of(pixels: FittedPixels, model: SharedModel, sizes: _Floats) -> _Floats:
    """Predict by how much departures bias the results of each pixel.

    Parameters
    ----------
    pixels : FittedPixels
        The pixels.
    model : SharedModel
        The model that was fitted, and the directions.
    sizes : ndarray of float, shape (direction,)
        Sizes of the departures.

    Returns
    -------
    ndarray of float, shape (pixel, band + 2)
        Bias of each band's photons, of the background's, and of the delay (ns), to first order.
    """
    bias = np.empty((len(pixels.counts), model.templates.bands + 2))
    for chosen, nuisance, directions, _ in _chunks(pixels, model):
        inverse, mixed = _projection(nuisance, directions)
        bias[chosen] = (inverse @ (mixed @ sizes)[..., None])[..., 0]
    return bias


def explained_by(pixels: FittedPixels, model: SharedModel, sizes: _Floats) -> _Floats:
    """Return how much better departures explain each pixel, to second order.

    Parameters
    ----------
    pixels : FittedPixels
        The pixels.
    model : SharedModel
        The model that was fitted, and the directions.
    sizes : ndarray of float, shape (direction,)
        Sizes of the departures.

    Returns
    -------
    ndarray of float, shape (pixel,)
        Twice the log-likelihood that they add, after the pixel's own parameters have followed.
    """
    gain = np.empty(len(pixels.counts))
    for chosen, nuisance, directions, residual in _chunks(pixels, model):
        change = np.einsum("d,pdi->pi", sizes, directions)[:, None]
        inverse, mixed = _projection(nuisance, change)
        left = (change - (inverse @ mixed).transpose(0, 2, 1) @ nuisance)[:, 0]
        gain[chosen] = (left * (2 * residual - left)).sum(axis=-1)
    return gain


def expected_sum(pixels: FittedPixels, model: SharedModel, edges_ns: _Floats) -> _Floats:
    """Sum the expected counts of all pixels at other bins.

    Parameters
    ----------
    pixels : FittedPixels
        The pixels.
    model : SharedModel
        The model that was fitted.
    edges_ns : ndarray of float, shape (bin + 1,)
        Edges of these bins, ns.

    Returns
    -------
    ndarray of float, shape (bin,)
        Expected counts.
    """
    steps, phase = np.unique(np.rint(pixels.arrival_ns / model.step_ns), return_inverse=True)
    photons = np.zeros((steps.size, model.templates.bands))
    np.add.at(photons, phase, pixels.amplitudes)
    total = pixels.background.sum() * model.background.shares(edges_ns)
    for first in range(0, steps.size, CHUNK_PIXELS):
        some = slice(first, first + CHUNK_PIXELS)
        shares = model.templates.shares(edges_ns, steps[some, None] * model.step_ns)
        total = total + np.einsum("sk,ksi->i", photons[some], shares)
    return total


def _chunks(
    pixels: FittedPixels, model: SharedModel
) -> Iterator[tuple[NDArray[np.intp], _Floats, _Floats, _Floats]]:
    """Pixels, nuisance (pixel, parameter, bin), directions and residual, over √expected counts."""
    edges, templates, step_ns = model.edges_ns, model.templates, model.step_ns
    longer = changed(templates, width_factor=1 + WIDTH_STEP)
    shorter = changed(templates, width_factor=1 - WIDTH_STEP)
    late = [drawn_out(templates, mean_ns) for mean_ns in model.tails_ns]
    flat = model.background.shares(edges)
    background_parts = _background_directions(model)
    mean_light = pixels.amplitudes.mean(axis=0)
    light = pixels.amplitudes.sum(axis=1)
    mean_ns = float(light @ (pixels.arrival_ns - pixels.offset_ns) / max(light.sum(), 1e-30))
    steps = np.rint(pixels.arrival_ns / step_ns)
    order = np.argsort(steps, kind="stable")
    for first in range(0, order.size, CHUNK_PIXELS):
        chosen = order[first : first + CHUNK_PIXELS]
        some = pixels.take(chosen)
        own, phase = np.unique(steps[chosen], return_inverse=True)
        delays = own[:, None] * step_ns

        def at(table: _Floats, phase: NDArray[np.intp] = phase) -> _Floats:
            """(band, delay, bin) of all delays → (pixel, band, bin)."""
            return table[:, phase].transpose(1, 0, 2)

        shares = templates.shares(edges, delays)
        width = (longer.shares(edges, delays) - shorter.shares(edges, delays)) / (2 * WIDTH_STEP)
        a = some.amplitudes[:, :, None]
        b = np.maximum(some.background, LEAST_BACKGROUND)[:, None]
        lit, later = at(shares), a * at(templates.slopes(edges, delays))
        mean = (a * lit).sum(axis=1) + b * flat
        tails = [(a * at(part.shares(edges, delays) - shares)).sum(axis=1) for part in late]
        offsets, place = np.unique(np.rint(some.offset_ns / step_ns), return_inverse=True)
        arrivals = mean_ns + offsets[:, None] * step_ns
        flares = [
            np.einsum("k,kdi->di", mean_light, templates.shares(edges, arrivals + delay_ns))[place]
            for delay_ns in model.flares_ns
        ]
        slope, *decays = (b * part for part in background_parts)
        root = 1 / np.sqrt(mean)
        nuisance = np.concatenate(
            [lit, np.broadcast_to(flat, mean.shape)[:, None], later.sum(axis=1)[:, None]], axis=1
        )
        shared = np.stack([slope, *tails, *decays, *flares], axis=1)
        directions = np.concatenate([later, a * at(width), shared], axis=1)
        residual = (some.counts - mean) * root
        yield chosen, nuisance * root[:, None], directions * root[:, None], residual


def _background_directions(model: SharedModel) -> list[_Floats]:
    """Derivatives (bin,) of the background's shares by its slope and by each decaying share."""
    edges, shape = model.edges_ns, model.background
    ramps = [BackgroundShape(slope=slope).shares(edges) for slope in (0.0, 1.0)]
    ramp = BackgroundShape(slope=shape.slope).shares(edges)
    decays = [BackgroundShape(decay_share=1.0, decay_ns=one) for one in model.decays_ns]
    slope = (1 - shape.decay_share) * (ramps[1] - ramps[0])
    return [slope, *(decay.shares(edges) - ramp for decay in decays)]


def _projection(nuisance: _Floats, directions: _Floats) -> tuple[_Floats, _Floats]:
    """Inverse of the nuisance parameters' information, and their products with directions."""
    normal = nuisance @ nuisance.transpose(0, 2, 1)
    scale = 1 / np.sqrt(np.maximum(np.einsum("paa->pa", normal), 1e-30))
    scaled = normal * scale[:, :, None] * scale[:, None, :] + RIDGE * np.eye(normal.shape[-1])
    inverse = np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :]
    return inverse, nuisance @ directions.transpose(0, 2, 1)
