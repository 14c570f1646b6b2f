# SPDX-License-Identifier: Apache-2.0
"""What is wrong with an entry of a description, in the words of the file instead of the parser."""

from __future__ import annotations

import re

#: types as msgspec calls them, and what a person writes
TYPES = {
    "str": "text in quotation marks",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "array": "a list in square brackets",
    "object": "a table",
    "null": "nothing",
}


def plain_reason(message: str, /) -> str:
    """Reword a message of msgspec about a document that does not have the right entries.

    Parameters
    ----------
    message : str
        Such as ``Expected `float`, got `str` - at `$.sensor.bin_width_ns```.

    Returns
    -------
    str
        Such as ``sensor.bin_width_ns: a number is needed, not text in quotation marks``; the
        message itself where it is of another form.
    """
    text, _, place = message.partition(" - at ")
    where = place.strip("`").removeprefix("$").removeprefix(".").replace("[...]", "")
    before = f"{where}: " if where else ""
    if found := re.fullmatch(r"Object contains unknown field `(.+)`", text):
        return f"{before}there is no entry {found[1]!r}; check its spelling and its table"
    if found := re.fullmatch(r"Object missing required field `(.+)`", text):
        return f"{before}the entry {found[1]!r} is missing"
    if found := re.fullmatch(r"Expected `(.+)`, got `(.+)`", text):
        wanted, given = (_type(name) for name in found.groups())
        return f"{before}{wanted} is needed, not {given}"
    if found := re.fullmatch(r"Invalid enum value (.+)", text):
        return f"{before}{found[1]} is none of the choices"
    return f"{before}{text}" if where else message


def _type(names: str) -> str:
    return " or ".join(TYPES.get(name.strip(), name.strip()) for name in names.split("|"))
