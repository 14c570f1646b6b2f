"""What no unbiased estimator can beat: Cramér–Rao bounds of depth and reflectance.

Poisson counts h_i with mean λ_i(θ) have the Fisher information
I_ab = Σ_i ∂_a λ_i ∂_b λ_i / λ_i (Kay, Estimation Theory, 1993, ch. 3); parameters are the
delay, one amplitude per band and a flat background. The standard deviation of each is at
least the root of its element on the diagonal of I⁻¹.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument


def fisher_information(
    shares: NDArray[np.floating],
    slopes: NDArray[np.floating],
    widths: NDArray[np.floating],
    amplitudes: ArrayLike,
    background: float,
) -> NDArray[np.float64]:
    """Information matrix of (delay, amplitude of each band, background).

    Parameters
    ----------
    shares : (band, bin) share of each band's photons per bin.
    slopes : (band, bin) derivative of `shares` by the delay, per ns.
    widths : (bin,) share of the background per bin.
    amplitudes : (band,) expected photons.
    background : expected photons over all bins.

    Returns
    -------
    (band + 2, band + 2).
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
    """Shares (band, bin), their slopes by delay (per ns) and flat widths (bin,) at a depth, m.

    From a calibration's measured waveforms, or from an instrument's own pulses.
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
    """Fisher information (band + 2)² of a pixel that expects `photons` of signal in all.

    Parameters and errors are those of `depth_bound`.
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
    """Least standard deviations of all parameters of an information matrix.

    With no background at all its amplitude sits on the edge of what is possible and is not
    estimated: its row is left out (NaN in the result).
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
    """Depth (m) of a delay (ns): half the way light goes."""
    return SPEED_OF_LIGHT_M_PER_NS * delay_deviation_ns / 2


def depth_bound(
    source: Calibration | Instrument,
    /,
    *,
    photons: float,
    reflectance: ArrayLike | None = None,
    background: float = 0.0,
    depth: float | None = None,
) -> float:
    """Least standard deviation of depth, in metres, that an unbiased estimator can reach.

    Parameters
    ----------
    source : a calibration (its measured waveforms and brightness count) or an instrument.
    photons : expected signal photons over all bands.
    reflectance : (band,) relative reflectance, default white.
    background : expected background photons over the whole period.
    depth : of the target, m; default the calibration's reference.

    Raises
    ------
    HueflightError
        If a number makes no sense, or there is no signal.
    """
    fisher = information(
        source, photons=photons, reflectance=reflectance, background=background, depth=depth
    )
    return depth_deviation(float(bounds(fisher, background=background)[0]))


def reflectance_bound(
    source: Calibration | Instrument,
    /,
    *,
    photons: float,
    reflectance: ArrayLike | None = None,
    background: float = 0.0,
    depth: float | None = None,
) -> NDArray[np.float64]:
    """Least standard deviation of each band's reflectance, shape (band,).

    Reflectance is in units of the one given (default white = 1). Parameters and errors are
    those of `depth_bound`.
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
