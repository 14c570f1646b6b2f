# SPDX-License-Identifier: Apache-2.0
"""An instrument as TOML text, and the meaning of each entry as its class documents it.

The classes are in `hueflight.model.instrument`, which imports this module.
"""

from __future__ import annotations

import html
import json
import re
from dataclasses import dataclass
from inspect import cleandoc
from textwrap import shorten
from typing import Any

import msgspec

TABLES = ("sensor", "timing", "lens", "bands")  #: entries of an instrument that are tables
SHOWN_BANDS = 12  #: of an instrument on one screen
SHOWN_CHARACTERS = 200  #: of its description


@dataclass(frozen=True)
class Entry:
    """One entry of an instrument file.

    Attributes
    ----------
    name : str
        Name of the entry.
    kind : str
        Its type, as the class documents it.
    default : str
        Value in TOML if the entry is left out; ``"required"`` if it must not be, ``"–"`` for none.
    meaning : str
        What it means, with its unit.
    """

    name: str
    kind: str
    default: str
    meaning: str


def entries(section: type[msgspec.Struct], /) -> list[Entry]:
    """List the entries of a table from its class: names, types, defaults and meanings.

    Parameters
    ----------
    section : type
        `Sensor`, `Timing`, `Lens`, `Band` or `Instrument`.

    Returns
    -------
    list of Entry
        The entries in the order of the class; of `Instrument` those that are no tables.
    """
    documented = _documented(section)
    found = []
    for field in msgspec.structs.fields(section):
        if field.name in TABLES:
            continue
        kind, meaning = documented[field.name]
        default = "–"
        if field.required:
            default = "required"
        elif field.default not in (None, ()):
            default = _value(field.default)
        found.append(Entry(field.name, kind, default, meaning))
    return found


def instrument_toml(instrument: Any, /) -> str:
    """Write an instrument as TOML that `Instrument.from_toml` reads as an equal instrument.

    Parameters
    ----------
    instrument : Instrument
        The instrument.

    Returns
    -------
    str
        The text. Entries that have their default are left out.
    """
    parts = [_table("", instrument)]
    for field in msgspec.structs.fields(type(instrument)):
        value = getattr(instrument, field.name)
        if isinstance(value, msgspec.Struct) and (field.required or value != field.default):
            parts.append(_table(f"[{field.name}]", value))
    parts += [_table("[[bands]]", band) for band in instrument.bands]
    return "\n".join(parts)


def instrument_facts(instrument: Any, /) -> dict[str, Any]:
    """List what matters of an instrument, for a screen.

    Parameters
    ----------
    instrument : Instrument
        The instrument.

    Returns
    -------
    dict
        Names, sizes, times, lens and bands, as plain values.
    """
    sensor, timing, lens = instrument.sensor, instrument.timing, instrument.lens
    rows, cols = instrument.image_shape
    angles = instrument.viewing_angles_deg(instrument.image_shape)
    shown: dict[str, Any] = {
        "instrument": instrument.name,
        "description": instrument.description or None,
        "pixels": f"{rows} rows, {cols} columns",
        "codes": f"{sensor.codes} of {sensor.bin_width_ns:g} ns, {sensor.direction}, code 0 is "
        f"{'a bin' if sensor.code_zero == 'bin' else 'no photon'}",
        "period_ns": timing.period_ns,
        "latency_ns": timing.latency_ns,
        "lens": "none: the directions of the pixels are unknown"
        if angles is None
        else f"{lens.focal_length_mm:g} mm, f/{lens.f_number:g}, "
        f"field of view {angles[0]:.1f}° × {angles[1]:.1f}°",
    }
    for band in instrument.bands:
        delays = ", ".join(f"{delay:g}" for delay in band.delays_ns[:4])
        delays += ", …" if len(band.delays_ns) > 4 else ""
        width = "" if band.emission_fwhm_nm is None else f" ± {band.emission_fwhm_nm / 2:g}"
        shown[f"band_{band.name}"] = (
            f"{band.wavelength_nm:g}{width} nm, fires at {delays} ns, "
            f"{band.pulse_fwhm_ns:g} ns wide"
        )
    return {**shown, "fingerprint": instrument.fingerprint()}


def one_screen(facts: dict[str, Any], /) -> dict[str, Any]:
    """Shorten the facts of an instrument so that they fit on one screen.

    Parameters
    ----------
    facts : dict
        What `instrument_facts` gives.

    Returns
    -------
    dict
        The facts that are not None, with a long description cut and no more than `SHOWN_BANDS`
        bands.
    """
    bands = [key for key in facts if key.startswith("band_")]
    left_out = bands[SHOWN_BANDS - 1 :] if len(bands) > SHOWN_BANDS else []
    shown: dict[str, Any] = {}
    for key, value in facts.items():
        if left_out and key == left_out[0]:
            shown["further_bands"] = f"{len(left_out)} more, as in its `bands`"
        if value is not None and key not in left_out:
            shown[key] = value
    if "description" in shown:
        shown["description"] = shorten(shown["description"], SHOWN_CHARACTERS, placeholder=" …")
    return shown


def facts_html(title: str, facts: dict[str, Any], /) -> str:
    """Write facts as an HTML table, as notebooks show it.

    Parameters
    ----------
    title : str
        Title of the table.
    facts : dict
        Names and values; None is left out.

    Returns
    -------
    str
        HTML.
    """
    rows = "".join(
        f"<tr><th style='text-align:left'>{html.escape(key.replace('_', ' '))}</th>"
        f"<td style='text-align:left'>{html.escape(str(value))}</td></tr>"
        for key, value in facts.items()
        if value is not None
    )
    return f"<table><caption>{html.escape(title)}</caption>{rows}</table>"


def _table(heading: str, section: msgspec.Struct) -> str:
    lines = [heading] if heading else []
    for field in msgspec.structs.fields(type(section)):
        value = getattr(section, field.name)
        if field.name in TABLES or value is None:
            continue
        if field.required or value != field.default:
            lines.append(f"{field.name} = {_value(value)}")
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, str):
        # the escapes of JSON are valid in TOML, which also forbids DEL
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))  # entries of type float accept it
    return repr(value)


def _documented(section: type[msgspec.Struct]) -> dict[str, tuple[str, str]]:
    """Type and meaning of each attribute, from the section *Attributes* of the docstring."""
    text = cleandoc(section.__doc__ or "")
    body = text.split("Attributes\n----------\n")[1]
    body = re.split(r"\n\n[A-Z][A-Za-z ]+\n-{3,}\n", body)[0]
    found: dict[str, tuple[str, str]] = {}
    for block in re.split(r"\n(?=\S)", body):
        head, *rest = block.strip().split("\n")
        names, kind = head.split(" : ", 1)
        meaning = " ".join(line.strip() for line in rest)
        for name in names.split(", "):
            found[name] = (kind, meaning)
    return found
