# SPDX-License-Identifier: Apache-2.0
"""Waveforms that arrive later, last longer, or are drawn out by an exponential delay."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.model.waveforms import Templates, b_spline


def changed(
    templates: Templates, *, delay_ns: ArrayLike = 0.0, width_factor: ArrayLike = 1.0
) -> Templates:
    """Return waveforms that arrive later and last longer.

    Parameters
    ----------
    templates : Templates
        The waveforms.
    delay_ns : array_like, shape (band,) or number
        How much later the centroid of each band arrives, ns.
    width_factor : array_like, shape (band,) or number
        Factor on the duration of each band about its centroid.

    Returns
    -------
    Templates
        The changed waveforms, still of area 1. They may be slightly negative where the given ones
        are not smooth; `Templates.normalized` removes that.
    """
    bands, knots = templates.coefficients.shape
    delays, factors = (np.broadcast_to(value, (bands,)) for value in (delay_ns, width_factor))
    centers = centroids_ns(templates)
    # the time of every knot, from half a circle before the centroid to half a circle after it
    knot_times = np.arange(knots) * templates.knot_ns
    half = templates.circle_ns / 2
    coefficients = np.empty((bands, knots))
    for band in range(bands):
        apart = (knot_times - centers[band] - delays[band] + half) % templates.circle_ns - half
        own = Templates(templates.coefficients[band : band + 1], templates.circle_ns)
        values = own.density(centers[band] + apart / factors[band])[0] / factors[band]
        coefficients[band] = _interpolating(values)
    return Templates(coefficients, templates.circle_ns)


def drawn_out(templates: Templates, mean_ns: float) -> Templates:
    """Return waveforms all of whose light arrives through an exponential delay.

    Parameters
    ----------
    templates : Templates
        The waveforms.
    mean_ns : float
        Mean of the delay, ns.

    Returns
    -------
    Templates
        Waveforms of the same area, 1.
    """
    knots = templates.coefficients.shape[-1]
    # each coefficient delayed by an exponential that starts in the middle of its knot's interval
    times = np.arange(knots) * templates.knot_ns
    late = np.exp(-np.maximum(times - templates.knot_ns / 2, 0) / mean_ns)
    early = np.exp(-(times + templates.knot_ns / 2) / mean_ns)
    kernel = (late - early) / -np.expm1(-templates.circle_ns / mean_ns)
    kernel /= kernel.sum()
    spectrum = np.fft.rfft(templates.coefficients, axis=-1) * np.fft.rfft(kernel)
    return Templates(np.fft.irfft(spectrum, knots, axis=-1), templates.circle_ns)


def centroids_ns(templates: Templates) -> NDArray[np.float64]:
    """Return the centroid of each band on the circle.

    Parameters
    ----------
    templates : Templates
        The waveforms.

    Returns
    -------
    ndarray of float, shape (band,)
        Centroids, ns. A band with several pulses has that of all of them.
    """
    coefficients, circle_ns = templates.coefficients, templates.circle_ns
    times = np.arange(coefficients.shape[-1]) * templates.knot_ns
    # about the circular mean, which is near enough that nothing wraps, the ordinary centroid
    phases = np.exp(2j * np.pi * times / circle_ns)
    near = np.angle(coefficients @ phases) * circle_ns / (2 * np.pi)
    apart = (times - near[:, None] + circle_ns / 2) % circle_ns - circle_ns / 2
    return near + (coefficients * apart).sum(axis=-1) / coefficients.sum(axis=-1)


def _interpolating(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients of the periodic cubic spline through values at the knots."""
    size = values.size
    kernel = np.zeros(size)
    for offset in (-1, 0, 1):
        kernel[offset % size] += float(b_spline(np.array(float(offset))))
    return np.fft.irfft(np.fft.rfft(values) / np.fft.rfft(kernel).real, size)
