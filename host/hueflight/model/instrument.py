# SPDX-License-Identifier: Apache-2.0
"""Description of an instrument: bands and their schedule, sensor, lens. Read strictly from TOML.

An `Instrument` is all that the rest of the host software needs to know about the origin of
counts, so data of any other camera can be used by describing that camera.
"""

from __future__ import annotations

import hashlib
import itertools
import tomllib
from functools import cache
from importlib import resources
from math import atan, degrees, inf, isfinite
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from hueflight.arguments import PATH, takes
from hueflight.errors import InstrumentError, InstrumentNotFoundError
from hueflight.model.instrument_text import (
    facts_html,
    instrument_facts,
    instrument_toml,
    one_screen,
)
from hueflight.model.pulses import Pulse, gaussian_sigma
from hueflight.model.time_bins import TimeBins
from hueflight.model.validation_text import plain_reason
from hueflight.recognition import what_is

SPEED_OF_LIGHT_M_PER_NS = 0.299792458  #: exact, SI
SHORTEST_NM = 50.0  #: light of shorter waves was stated in micrometers
USUAL_FRAME_RATE_HZ = 1000.0  #: of a sensor whose frame rate is not stated
USUAL_FWHM_NM = 20.0  #: of an LED whose emission spectrum is not stated


class _Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A strict, immutable table of the instrument file."""


@cache
def _number_fields(kind: type[_Section]) -> dict[str, type[int] | type[float]]:
    """Fields of a section that hold numbers, with the type of these."""

    def leaves(annotation: Any) -> set[Any]:
        parts = get_args(annotation)
        return set().union(*map(leaves, parts)) if parts else {annotation}

    types = {field.name: leaves(field.type) for field in msgspec.structs.fields(kind)}
    return {
        name: float if float in found else int
        for name, found in types.items()
        if found & {int, float}
    }


def _normalize_numbers(section: _Section) -> None:
    """Store numbers in the type of their field: 640 and 640.0 are equal but read differently."""
    for name, kind in _number_fields(type(section)).items():
        value = getattr(section, name)
        if isinstance(value, tuple):
            normal: Any = tuple(_normal(entry, kind) for entry in value)
        else:
            normal = _normal(value, kind)
        msgspec.structs.force_setattr(section, name, normal)


def _normal(value: Any, kind: type[int] | type[float]) -> Any:
    """Convert a number to a type that holds it; anything else is left to the checks."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return value
    if kind is float:
        return float(value) + 0.0  # which makes 0.0 of -0.0
    return int(value) if isfinite(value) and value == int(value) else value


def _positive(where: str, value: float) -> None:
    if not (isfinite(value) and value > 0):
        raise InstrumentError(f"{where} = {value!r}: must be a finite number above 0")


def _not_negative(where: str, value: float) -> None:
    if not (isfinite(value) and value >= 0):
        raise InstrumentError(f"{where} = {value!r}: must be a finite number, 0 or more")


class Sensor(_Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A time-resolving single-photon array and what its codes mean.

    Attributes
    ----------
    rows, cols : int
        Number of pixels.
    code_bits : int
        Width of a code; a histogram has ``2**code_bits`` codes.
    bin_width_ns : float
        Nominal width of one code, ns.
    direction : {"forward", "reverse"}
        ``"reverse"`` where later photons have smaller codes: the photon starts the converter and a
        clock stops it.
    code_zero : {"no photon", "bin"}
        ``"no photon"`` where code 0 reports an exposure without a photon.
    frame_rate_hz : float or None
        Readouts per second.
    exposure_ms : float or None
        Exposure time of a frame, ms; None for an exposure of one period.
    pixel_width_um, pixel_height_um : float or None
        Pitch of the pixels along a row and along a column, µm.
    scan_steps : int
        Positions of a scanned sensor; an image has ``rows * scan_steps`` rows.
    dark_count_hz : float
        Typical dark counts per second and pixel.
    detection_wavelength_nm : tuple of float
        Wavelengths of the table of detection probabilities, rising, nm.
    detection_probability : tuple of float
        Photon detection probability at these wavelengths.
    """

    rows: int
    cols: int
    code_bits: int
    bin_width_ns: float
    direction: Literal["forward", "reverse"] = "forward"
    code_zero: Literal["no photon", "bin"] = "bin"
    frame_rate_hz: float | None = None
    exposure_ms: float | None = None
    pixel_width_um: float | None = None
    pixel_height_um: float | None = None
    scan_steps: int = 1
    dark_count_hz: float = 0.0
    detection_wavelength_nm: tuple[float, ...] = ()
    detection_probability: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _normalize_numbers(self)
        for name in ("rows", "cols", "scan_steps"):
            if getattr(self, name) < 1:
                raise InstrumentError(f"sensor.{name} = {getattr(self, name)}: must be at least 1")
        if self.rows > 1024 or self.cols > 1024:
            raise InstrumentError(
                f"sensor has {self.rows} × {self.cols} pixels; the wire format carries at most "
                "1024 × 1024: split the sensor or use scan_steps"
            )
        if not 1 <= self.code_bits <= 16:
            raise InstrumentError(f"sensor.code_bits = {self.code_bits}: must be 1 to 16")
        _positive("sensor.bin_width_ns", self.bin_width_ns)
        _not_negative("sensor.dark_count_hz", self.dark_count_hz)
        for name in ("frame_rate_hz", "exposure_ms", "pixel_width_um", "pixel_height_um"):
            if (value := getattr(self, name)) is not None:
                _positive(f"sensor.{name}", value)
        nodes, table = self.detection_wavelength_nm, self.detection_probability
        if len(nodes) != len(table):
            raise InstrumentError(
                f"sensor.detection_wavelength_nm has {len(nodes)} entries but "
                f"detection_probability has {len(table)}: give one for each"
            )
        if any(b <= a for a, b in itertools.pairwise(nodes)):
            raise InstrumentError(f"sensor.detection_wavelength_nm must rise; it is {nodes}")
        if any(not 0 <= p <= 1 for p in table):
            raise InstrumentError(f"sensor.detection_probability must lie in 0..1; it is {table}")

    @property
    def codes(self) -> int:
        """Number of codes, 2**code_bits: the length of a histogram's last axis."""
        return 1 << self.code_bits

    @property
    def usual_frame_rate_hz(self) -> float:
        """Frame rate that is stated, or `USUAL_FRAME_RATE_HZ` to plan with where none is."""
        return self.frame_rate_hz or USUAL_FRAME_RATE_HZ

    @property
    def reports_empty(self) -> bool:
        """Whether code 0 counts the exposures without a photon."""
        return self.code_zero == "no photon"


class Timing(_Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The pulse train in time.

    Attributes
    ----------
    period_ns : float or None
        Duration of one LED train, ns; None for a sensor whose codes cover a single shot.
    pulse_width_ns : float
        Electrical width of each LED's drive pulse, ns.
    latency_ns : float
        Arrival time within the period of a pulse of delay 0 from distance 0, ns.
    """

    period_ns: float | None = None
    pulse_width_ns: float = 10.0
    latency_ns: float = 0.0

    def __post_init__(self) -> None:
        _normalize_numbers(self)
        if self.period_ns is not None:
            _positive("timing.period_ns", self.period_ns)
        _positive("timing.pulse_width_ns", self.pulse_width_ns)
        _not_negative("timing.latency_ns", self.latency_ns)


class Band(_Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One LED colour.

    Attributes
    ----------
    name : str
        Name of the band.
    wavelength_nm : float
        Peak wavelength of the emission, nm.
    delay_ns : float or tuple of float
        When the LED fires in the period, ns; several values for a coded train.
    pulse_fwhm_ns : float
        Full width at half maximum of the optical pulse, tail included, ns.
    pulse_tail_ns : float
        Decay constant of the trailing edge, ns; 0 for a Gaussian pulse.
    emission_fwhm_nm : float or None
        Full width at half maximum of the emission spectrum, nm. Without it, colors are computed
        with 20 nm, that of a usual LED, and exported files state no width.
    power_mw : float
        Average optical power while the train runs, mW.
    """

    name: str
    wavelength_nm: float
    delay_ns: float | tuple[float, ...] = 0.0
    pulse_fwhm_ns: float = 10.0
    pulse_tail_ns: float = 0.0
    emission_fwhm_nm: float | None = None
    power_mw: float = 1.0

    def __post_init__(self) -> None:
        _normalize_numbers(self)
        for name in ("wavelength_nm", "pulse_fwhm_ns", "emission_fwhm_nm", "power_mw"):
            if (value := getattr(self, name)) is not None:
                _positive(f"band {self.name!r}: {name}", value)
        if self.wavelength_nm < SHORTEST_NM:
            raise InstrumentError(
                f"band {self.name!r}: wavelength_nm = {self.wavelength_nm:g}: give it in "
                f"nanometers, such as {self.wavelength_nm * 1000:g} for {self.wavelength_nm:g} µm"
            )
        _not_negative(f"band {self.name!r}: pulse_tail_ns", self.pulse_tail_ns)
        if not self.delays_ns:
            raise InstrumentError(f"band {self.name!r}: delay_ns is empty: give at least one delay")
        for delay in self.delays_ns:
            _not_negative(f"band {self.name!r}: delay_ns", delay)

    @property
    def spectral_fwhm_nm(self) -> float:
        """Width of the emission that colors are computed with, nm: the stated one, or 20."""
        return USUAL_FWHM_NM if self.emission_fwhm_nm is None else self.emission_fwhm_nm

    @property
    def delays_ns(self) -> tuple[float, ...]:
        """All firing times of the band within the period."""
        return self.delay_ns if isinstance(self.delay_ns, tuple) else (self.delay_ns,)


class Lens(_Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A distortion-free lens: the chief ray of a pixel goes through the centre.

    Attributes
    ----------
    focal_length_mm : float
        Focal length, mm.
    f_number : float
        Focal length over aperture diameter.
    transmission : float
        Fraction of the light that the lens transmits.
    """

    focal_length_mm: float
    f_number: float = 1.4
    transmission: float = 0.9

    def __post_init__(self) -> None:
        _normalize_numbers(self)
        _positive("lens.focal_length_mm", self.focal_length_mm)
        _positive("lens.f_number", self.f_number)
        if not 0 < self.transmission <= 1:
            raise InstrumentError(
                f"lens.transmission = {self.transmission!r}: must be above 0 and at most 1"
            )


class Instrument(_Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Bands, timing, sensor and lens of one instrument.

    Everything that computes with counts takes an instrument, because it says which code stands for
    which arrival time and which pulse belongs to which band. Take a preset or read a TOML file with
    `Instrument.load`; describe your own camera in a TOML file whose tables are ``[sensor]``,
    ``[timing]``, ``[[bands]]`` and, if depth along the optical axis is wanted, ``[lens]``. Unknown,
    missing and contradictory entries are refused. Instruments are immutable: `replace` makes a
    changed copy.

    Attributes
    ----------
    name : str
        Short name, which appears in files and messages.
    description : str
        Free text for people; nothing depends on it.
    sensor : Sensor
        The single-photon array and the meaning of its codes.
    timing : Timing
        Period and width of the drive pulses.
    bands : tuple of Band
        The LEDs. Their order is that of the axis `band` of every array.
    lens : Lens or None
        The lens, which gives each pixel a direction. Without it every pixel looks along the optical
        axis.

    See Also
    --------
    hueflight.calibrate : Measure what a description can't state.
    Schedule : The delays of all bands, apart from the rest of the instrument.

    Examples
    --------
    >>> instrument = Instrument.load("paper")
    >>> instrument.histogram_shape
    (192, 128, 512)
    >>> instrument.wavelengths_nm.size == len(instrument.bands)
    True
    """

    name: str
    description: str = ""
    sensor: Sensor
    timing: Timing = Timing()
    bands: tuple[Band, ...]
    lens: Lens | None = None

    def __post_init__(self) -> None:
        if not self.bands:
            raise InstrumentError(f"instrument {self.name!r} has no bands: give at least one")
        names = [band.name for band in self.bands]
        if len(set(names)) != len(names):
            raise InstrumentError(f"instrument {self.name!r}: band names repeat: {names}")
        if self.lens and not (self.sensor.pixel_width_um and self.sensor.pixel_height_um):
            raise InstrumentError(
                f"instrument {self.name!r} has a lens but no sensor.pixel_width_um and "
                "pixel_height_um: give the pixel pitch or leave the lens out"
            )
        period = self.timing.period_ns
        if period is None:
            return
        for band in self.bands:
            if max(band.delays_ns) >= period:
                raise InstrumentError(
                    f"band {band.name!r}: delay_ns = {band.delay_ns} lies outside the period "
                    f"of {period} ns"
                )
        if self.sensor.bin_width_ns > period:
            raise InstrumentError(
                f"sensor.bin_width_ns = {self.sensor.bin_width_ns:g} is longer than the period of "
                f"{period:g} ns: give both in nanoseconds, such as "
                f"{self.sensor.bin_width_ns / 1000:g} for bins of {self.sensor.bin_width_ns:g} ps"
            )
        needed = TimeBins.codes_needed(period, self.sensor.bin_width_ns)
        usable = self.sensor.codes - self.sensor.reports_empty
        if needed > usable:
            raise InstrumentError(
                f"a period of {period} ns needs {needed} codes of {self.sensor.bin_width_ns} ns "
                f"but {self.sensor.code_bits}-bit codes leave {usable}: use wider bins, more "
                "bits or a shorter period"
            )

    # -- reading and writing ------------------------------------------------------------------

    @classmethod
    def presets(cls) -> tuple[str, ...]:
        """List the names that `load` knows without a file.

        Returns
        -------
        tuple of str
            Names of the presets, sorted.
        """
        folder = resources.files("hueflight.model") / "presets"
        return tuple(sorted(p.name[:-5] for p in folder.iterdir() if p.name.endswith(".toml")))

    @classmethod
    @takes(source=PATH)
    def load(cls, source: str | Path) -> Instrument:
        """Load a preset, or read an instrument from a TOML file.

        Parameters
        ----------
        source : str or Path
            Name of a preset (see `presets`) or path of a file.

        Returns
        -------
        Instrument
            The instrument.

        Raises
        ------
        InstrumentNotFoundError
            If there is neither a preset nor a file of that name.
        InstrumentError
            If the file can't be read or does not describe an instrument.
        """
        if isinstance(source, str) and source in cls.presets():
            text = (resources.files("hueflight.model") / "presets" / f"{source}.toml").read_text(
                "utf-8"
            )
            return cls.from_toml(text, where=f"preset {source!r}")
        path = Path(source)
        try:
            text = path.read_text("utf-8-sig")  # some editors begin with a byte order mark
        except FileNotFoundError:
            raise InstrumentNotFoundError(
                f"no instrument {str(source)!r}: neither a file nor one of the presets "
                f"{', '.join(cls.presets())}"
            ) from None
        except (IsADirectoryError, UnicodeDecodeError):
            raise InstrumentError(
                f"{str(path)!r} is {what_is(path)}, not the description of an instrument: give a "
                f"TOML file or one of the presets {', '.join(cls.presets())}"
            ) from None
        except OSError as error:
            reason = error.strerror or error
            raise InstrumentError(f"can't read instrument file {str(path)!r}: {reason}") from None
        if not text.strip():
            raise InstrumentError(
                f"{str(path)!r} is an empty file: hueflight instrument new describes an instrument"
            )
        return cls.from_toml(text, where=str(path))

    @classmethod
    def from_toml(cls, text: str, *, where: str = "instrument") -> Instrument:
        """Read an instrument from TOML text.

        Parameters
        ----------
        text : str
            The description.
        where : str
            Origin of the text, for errors.

        Returns
        -------
        Instrument
            The instrument.

        Raises
        ------
        InstrumentError
            If the text is not TOML, has unknown, missing or ill-typed keys, or contradicts itself.
        """
        try:
            return msgspec.convert(tomllib.loads(text), cls)
        except tomllib.TOMLDecodeError as error:
            raise InstrumentError(f"{where} is not TOML: {error}") from None
        except msgspec.ValidationError as error:
            # a check of ours arrives wrapped, with its own words as the cause
            cause = error.__cause__ if isinstance(error.__cause__, InstrumentError) else error
            raise InstrumentError(f"{where}: {plain_reason(str(cause))}") from None

    @classmethod
    def from_json(cls, text: str | bytes, *, where: str = "instrument") -> Instrument:
        """Read an instrument from the text that `to_json` wrote.

        Recordings and calibrations hold their instrument in this form.

        Parameters
        ----------
        text : str or bytes
            The description.
        where : str
            Origin of the text, for errors.

        Returns
        -------
        Instrument
            The instrument.

        Raises
        ------
        InstrumentError
            If the text is not JSON or does not describe an instrument.
        """
        try:
            return msgspec.json.decode(text, type=cls)
        except msgspec.DecodeError as error:
            # a check of ours arrives wrapped, with its own words as the cause
            cause = error.__cause__ if isinstance(error.__cause__, InstrumentError) else error
            raise InstrumentError(f"{where}: {plain_reason(str(cause))}") from None

    def to_json(self) -> str:
        """Write the whole description as JSON.

        Returns
        -------
        str
            JSON with sorted keys; equal instruments give equal text.
        """
        return msgspec.json.encode(self, order="sorted").decode()

    def to_toml(self) -> str:
        """Write the description as TOML, as a file for `load`.

        Returns
        -------
        str
            The text, without the entries that have their default; `from_toml` reads it as an equal
            instrument.
        """
        return instrument_toml(self)

    def facts(self) -> dict[str, Any]:
        """List what matters of the instrument, for a screen.

        Returns
        -------
        dict
            Names, sizes, times, lens and bands, as plain values.
        """
        return instrument_facts(self)

    def __repr__(self) -> str:
        lines = [f"  {key}: {value}" for key, value in one_screen(self.facts()).items()]
        return "\n".join([f"<Instrument {self.name!r}>", *lines])

    def _repr_html_(self) -> str:
        return facts_html(f"Instrument {self.name}", one_screen(self.facts()))

    def fingerprint(self) -> str:
        """Compute a short digest of everything that counts depend on.

        Returns
        -------
        str
            16 hexadecimal digits of the SHA-256 digest of the description, without `name` and
            `description`.
        """
        physical = msgspec.structs.replace(_as_computed(self), name="", description="")
        return hashlib.sha256(physical.to_json().encode()).hexdigest()[:16]

    def differences(self, other: Instrument) -> list[str]:
        """List the entries in which two instruments differ; name and description are not compared.

        Parameters
        ----------
        other : Instrument
            Instrument to compare with.

        Returns
        -------
        list of str
            One line ``key: value here != value there`` for each difference.
        """
        mine, theirs = (
            _flatten(msgspec.to_builtins(_as_computed(instrument))) for instrument in (self, other)
        )
        keys = [k for k in {**mine, **theirs} if k not in ("name", "description")]
        return [
            f"{key}: {mine.get(key)!r} != {theirs.get(key)!r}"
            for key in keys
            if mine.get(key) != theirs.get(key)
        ]

    def replace(self, **changes: Any) -> Instrument:
        """Make a copy with some sections replaced, which is checked like any other instrument.

        Parameters
        ----------
        **changes : Any
            New values by attribute, such as ``timing=Timing(period_ns=500)``.

        Returns
        -------
        Instrument
            The changed copy.

        Raises
        ------
        InstrumentError
            If the changed description contradicts itself.
        """
        return msgspec.structs.replace(self, **changes)

    # -- shapes -------------------------------------------------------------------------------

    @property
    def image_shape(self) -> tuple[int, int]:
        """Shape (row, col) of an image, with all scan steps stacked along the rows."""
        return self.sensor.rows * self.sensor.scan_steps, self.sensor.cols

    @property
    def histogram_shape(self) -> tuple[int, int, int]:
        """Shape (row, col, code) of a histogram."""
        return (*self.image_shape, self.sensor.codes)

    @property
    def wavelengths_nm(self) -> NDArray[np.float64]:
        """Peak wavelength of each band, shape (band,), nm."""
        return np.array([band.wavelength_nm for band in self.bands])

    # -- time ---------------------------------------------------------------------------------

    def time_bins(self) -> TimeBins:
        """Compute the codes in order of arrival time and their nominal edges.

        Returns
        -------
        TimeBins
            The bins. A calibration holds the same bins with measured widths.
        """
        sensor = self.sensor
        return TimeBins.nominal(
            codes=sensor.codes,
            first_code=int(sensor.reports_empty),
            bin_width_ns=sensor.bin_width_ns,
            period_ns=self.timing.period_ns,
            reverse=sensor.direction == "reverse",
        )

    def pulses(self, band: int) -> tuple[Pulse, ...]:
        """Compute the optical pulses of a band as they would arrive from distance 0.

        Parameters
        ----------
        band : int
            Index of the band.

        Returns
        -------
        tuple of Pulse
            One pulse for each delay of the band; their areas sum to 1.
        """
        description = self.bands[band]
        sigma_ns = gaussian_sigma(description.pulse_fwhm_ns, description.pulse_tail_ns)
        share = 1 / len(description.delays_ns)
        return tuple(
            Pulse(
                center_ns=self.timing.latency_ns + delay,
                sigma_ns=sigma_ns,
                tail_ns=description.pulse_tail_ns,
                area=share,
            )
            for delay in description.delays_ns
        )

    def band_brightness(self) -> NDArray[np.float64]:
        """Compute the relative photon rate of each band from a white target.

        Optical power times wavelength (photons per joule) times the detection probability, where
        the sensor has a table of it.

        Returns
        -------
        ndarray of float, shape (band,)
            Rates relative to their mean.

        Raises
        ------
        InstrumentError
            If the detection probability is 0 at the wavelengths of all bands.
        """
        wavelength_nm = self.wavelengths_nm
        rate = np.array([band.power_mw for band in self.bands]) * wavelength_nm
        if self.sensor.detection_wavelength_nm:
            rate = rate * np.interp(
                wavelength_nm,
                self.sensor.detection_wavelength_nm,
                self.sensor.detection_probability,
            )
        if not rate.any():
            raise InstrumentError(
                "sensor.detection_probability is 0 at every band's wavelength: extend the table"
            )
        return rate / rate.mean()

    def half_spacing_ns(self) -> float:
        """Compute half the smallest gap between two pulses of the train.

        A longer delay moves a pulse closer to its neighbour's place than to its own.

        Returns
        -------
        float
            Half the gap, ns; infinite for a single pulse without a period.
        """
        period = self.timing.period_ns
        starts = sorted(float(delay) for band in self.bands for delay in band.delays_ns)
        if period is not None:
            starts.append(starts[0] + period)
        return min((late - early for early, late in itertools.pairwise(starts)), default=inf) / 2

    # -- geometry -----------------------------------------------------------------------------

    def ray_cosine(self) -> NDArray[np.float64]:
        """Compute the cosine between each pixel's ray and the optical axis.

        A time of flight measures the distance along the ray; depth is counted along the axis, so
        depth is distance times this cosine.

        Returns
        -------
        ndarray of float, shape (row, col)
            Cosines; 1 everywhere without a lens.
        """
        x, y = self.ray_slopes()
        return 1 / np.sqrt(1 + x**2 + y**2)

    def viewing_angles_deg(self, pixels: tuple[int, int], /) -> tuple[float, float] | None:
        """Compute the angles that a block of pixels around the optical axis covers.

        Parameters
        ----------
        pixels : tuple of int
            Rows and columns of the block: ``(1, 1)`` for one pixel, `image_shape` for the field of
            view.

        Returns
        -------
        tuple of float or None
            Angles across and down between the outer edges, degrees; None without a lens.
        """
        if self.lens is None:
            return None
        rows, cols = pixels
        width_um, height_um = self.sensor.pixel_width_um, self.sensor.pixel_height_um
        assert width_um is not None  # checked in __post_init__
        assert height_um is not None
        half_mm = 0.5e-3 * cols * width_um, 0.5e-3 * rows * height_um
        across, down = (2 * degrees(atan(half / self.lens.focal_length_mm)) for half in half_mm)
        return across, down

    def ray_slopes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Compute the direction of each pixel's ray as slopes against the optical axis.

        Returns
        -------
        right : ndarray of float, shape (row, col)
            Metres to the right per metre of depth.
        down : ndarray of float, shape (row, col)
            Metres downwards per metre of depth.
        """
        rows, cols = self.image_shape
        if self.lens is None:
            return np.zeros((rows, cols)), np.zeros((rows, cols))
        width_um, height_um = self.sensor.pixel_width_um, self.sensor.pixel_height_um
        assert width_um is not None  # checked in __post_init__
        assert height_um is not None
        to_slope = np.float64(1e-3 / self.lens.focal_length_mm)
        right = (np.arange(cols) - (cols - 1) / 2) * width_um * to_slope
        down = (np.arange(rows) - (rows - 1) / 2) * height_um * to_slope
        return np.broadcast_to(right, (rows, cols)), np.broadcast_to(down[:, None], (rows, cols))


def _as_computed(instrument: Instrument) -> Instrument:
    """The instrument with the numbers that stand for what it does not state."""
    bands = tuple(
        msgspec.structs.replace(band, emission_fwhm_nm=band.spectral_fwhm_nm)
        for band in instrument.bands
    )
    return msgspec.structs.replace(instrument, bands=bands)


def _flatten(tree: Any, path: str = "") -> dict[str, Any]:
    """Leaves of nested dicts and lists, keyed by dotted path."""
    if isinstance(tree, dict):
        items = ((f"{path}.{key}" if path else str(key), value) for key, value in tree.items())
    elif isinstance(tree, list | tuple) and any(isinstance(v, dict) for v in tree):
        items = ((f"{path}[{i}]", value) for i, value in enumerate(tree))
    else:
        return {path: tree}
    return {leaf: value for key, sub in items for leaf, value in _flatten(sub, key).items()}
