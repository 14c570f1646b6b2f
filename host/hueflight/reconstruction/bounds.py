# SPDX-License-Identifier: Apache-2.0
"""Cramér–Rao bounds of depth and reflectance: what no unbiased estimator can beat.

Poisson counts h_i with mean λ_i(θ) have the Fisher information I_ab = Σ_i ∂_a λ_i ∂_b λ_i / λ_i
(Kay, Estimation Theory, 1993, ch. 3); parameters are the delay, one amplitude per band and a flat
background. The standard deviation of each is at least the root of its element on the diagonal of
I⁻¹.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.arguments import NUMBER, NUMBERS, Kind, takes
from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument

#: what `source` may be
SOURCE = Kind(
    "a Calibration or an Instrument", lambda value: isinstance(value, Calibration | Instrument)
)


def fisher_information(
    shares: NDArray[np.floating],
    slopes: NDArray[np.floating],
    widths: NDArray[np.floating],
    amplitudes: ArrayLike,
    background: float,
) -> NDArray[np.float64]:
    """Return the information matrix of (delay, amplitude of each band, background).

    Parameters
    ----------
    shares : ndarray of float, shape (band, bin)
        Share of each band's photons per bin.
    slopes : ndarray of float, shape (band, bin)
        Derivative of `shares` by the delay, per ns.
    widths : ndarray of float, shape (bin,)
        Share of the background per bin.
    amplitudes : array_like, shape (band,)
        Expected photons of each band.
    background : float
        Expected photons of the background over all bins.

    Returns
    -------
    ndarray of float, shape (band + 2, band + 2)
        Information matrix.
    """
    signal = np.asarray(amplitudes, dtype=np.float64)
    mean = signal @ shares + background * widths
    jacobian = np.vstack([signal @ slopes, shares, widths])
    # bins where nothing is expected tell nothing
    weight = np.divide(1.0, mean, out=np.zeros_like(mean), where=mean > 1e-300)
    return (jacobian * weight) @ jacobian.T


def expected_shares(
    source: Calibration | Instrument, depth: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the waveforms that are expected at a depth.

    Parameters
    ----------
    source : Calibration or Instrument
        A calibration, whose measured waveforms count, or an instrument, whose nominal pulses do.
    depth : float
        Depth, m.

    Returns
    -------
    shares, slopes : ndarray of float, shape (band, bin)
        Share of each band's photons per bin, and its derivative by the delay, per ns.
    widths : ndarray of float, shape (bin,)
        Share of the background per bin.
    """
    if isinstance(source, Calibration):
        edges_ns = source.bins.edges_ns
        delay_ns = 2 * (depth - source.distance) / SPEED_OF_LIGHT_M_PER_NS
        shares = source.templates.shares(edges_ns, delay_ns)
        slopes = source.templates.slopes(edges_ns, delay_ns)
        return shares, slopes, source.bins.widths_ns / source.bins.span_ns
    bins = source.time_bins()
    period_ns = bins.period_ns
    edges_ns = bins.edges_ns - 2 * depth / SPEED_OF_LIGHT_M_PER_NS
    shares, slopes = [], []
    for band in range(len(source.bands)):
        pulses = source.pulses(band)
        shares.append(np.sum([p.share(edges_ns, period_ns) for p in pulses], axis=0))
        # d/dτ ∫ p(t − τ) dt = −[p] at the bin's edges
        edge_density = np.sum([p.wrapped_density(edges_ns, period_ns) for p in pulses], axis=0)
        slopes.append(-np.diff(edge_density))
    return np.array(shares), np.array(slopes), bins.widths_ns / bins.span_ns


def information(
    source: Calibration | Instrument,
    *,
    photons: float,
    reflectance: ArrayLike | None = None,
    background: float = 0.0,
    depth: float | None = None,
) -> NDArray[np.float64]:
    """Return the Fisher information of a pixel that expects a number of signal photons.

    Parameters
    ----------
    source : Calibration or Instrument
        A calibration or an instrument.
    photons : float
        Expected signal photons over all bands.
    reflectance : array_like, shape (band,), optional
        Relative reflectance, by default white.
    background : float
        Expected background photons over the whole period.
    depth : float, optional
        Depth of the target, m; by default that of the calibration's reference.

    Returns
    -------
    ndarray of float, shape (band + 2, band + 2)
        Information matrix of delay, amplitudes and background.

    Raises
    ------
    HueflightError
        If a number is out of range, or there is no signal.
    """
    white = _brightness_of(source)
    colour = np.ones(white.size) if reflectance is None else np.asarray(reflectance, float)
    if colour.shape != white.shape or not np.isfinite(colour).all() or (colour < 0).any():
        raise HueflightError(
            f"reflectance = {colour.tolist()}: must be {white.size} finite numbers, 0 or more, "
            "one for each band"
        )
    if not (np.isfinite(photons) and photons > 0 and np.isfinite(background) and background >= 0):
        raise HueflightError(
            f"photons = {photons!r}, background = {background!r}: photons must be above 0 and "
            "background 0 or more"
        )
    amplitudes = white * colour
    if not amplitudes.any():
        raise HueflightError("reflectance is 0 in every band: there is no signal to bound")
    if depth is None:
        depth = source.distance if isinstance(source, Calibration) else 0.0
    amplitudes = amplitudes * (photons / amplitudes.sum())
    return fisher_information(*expected_shares(source, depth), amplitudes, background)


def bounds(fisher: NDArray[np.floating], *, background: float) -> NDArray[np.float64]:
    """Return the least standard deviations of all parameters of an information matrix.

    Without any background, its amplitude is at the edge of what is possible and is not estimated:
    its row is left out, and the result is NaN there.

    Parameters
    ----------
    fisher : ndarray of float, shape (parameter, parameter)
        Information matrix.
    background : float
        Expected background photons.

    Returns
    -------
    ndarray of float, shape (parameter,)
        Standard deviations.
    """
    known = fisher.shape[0] - (1 if background == 0 else 0)
    # bands without light have unbounded information; scale before inverting
    part = fisher[:known, :known]
    scale = np.sqrt(np.diag(part))
    scale[scale == 0] = 1.0
    inverse = np.linalg.inv(part / np.outer(scale, scale))
    deviation = np.full(fisher.shape[0], np.nan)
    deviation[:known] = np.sqrt(np.diag(inverse)) / scale
    return deviation


def depth_deviation(delay_deviation_ns: float) -> float:
    """Convert a deviation of delay to one of depth.

    Parameters
    ----------
    delay_deviation_ns : float
        Standard deviation of the delay.

    Returns
    -------
    float
        Standard deviation of depth, m: half the distance that light travels.
    """
    return SPEED_OF_LIGHT_M_PER_NS * delay_deviation_ns / 2


@takes(source=SOURCE, photons=NUMBER, reflectance=NUMBERS, background=NUMBER, depth=NUMBER)
def depth_bound(
    source: Calibration | Instrument,
    /,
    *,
    photons: float,
    reflectance: ArrayLike | None = None,
    background: float = 0.0,
    depth: float | None = None,
) -> float:
    """Return the least standard deviation of depth that an unbiased estimator can reach.

    Parameters
    ----------
    source : Calibration or Instrument
        A calibration, whose measured waveforms and brightness count, or an instrument.
    photons : float
        Expected signal photons over all bands.
    reflectance : array_like, shape (band,), optional
        Relative reflectance, by default white.
    background : float
        Expected background photons over the whole period.
    depth : float, optional
        Depth of the target, m; by default that of the calibration's reference.

    Returns
    -------
    float
        Standard deviation of depth, m.

    Raises
    ------
    HueflightError
        If a number is out of range, or there is no signal.
    """
    fisher = information(
        source, photons=photons, reflectance=reflectance, background=background, depth=depth
    )
    return depth_deviation(float(bounds(fisher, background=background)[0]))


@takes(source=SOURCE, photons=NUMBER, reflectance=NUMBERS, background=NUMBER, depth=NUMBER)
def reflectance_bound(
    source: Calibration | Instrument,
    /,
    *,
    photons: float,
    reflectance: ArrayLike | None = None,
    background: float = 0.0,
    depth: float | None = None,
) -> NDArray[np.float64]:
    """Return the least standard deviation of the reflectance in each band.

    Parameters
    ----------
    source : Calibration or Instrument
        A calibration, whose measured waveforms and brightness count, or an instrument.
    photons : float
        Expected signal photons over all bands.
    reflectance : array_like, shape (band,), optional
        Relative reflectance, by default white.
    background : float
        Expected background photons over the whole period.
    depth : float, optional
        Depth of the target, m; by default that of the calibration's reference.

    Returns
    -------
    ndarray of float, shape (band,)
        Standard deviations, in units of the given reflectance (by default white = 1).

    Raises
    ------
    HueflightError
        If a number is out of range, or there is no signal.
    """
    fisher = information(
        source, photons=photons, reflectance=reflectance, background=background, depth=depth
    )
    brightness = _brightness_of(source)
    colour = np.ones(brightness.size) if reflectance is None else np.asarray(reflectance, float)
    photons_per_reflectance = brightness * photons / (brightness @ colour)
    return bounds(fisher, background=background)[1 : 1 + brightness.size] / photons_per_reflectance


def _brightness_of(source: Calibration | Instrument) -> NDArray[np.float64]:
    """(band,) relative photon rate of a white target."""
    return source.brightness if isinstance(source, Calibration) else source.band_brightness()
