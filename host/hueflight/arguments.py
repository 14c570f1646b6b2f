# SPDX-License-Identifier: Apache-2.0
"""Check of the types of arguments of public functions, so that a mix-up is said in one sentence."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from inspect import signature
from math import isfinite
from operator import index
from typing import Any, ParamSpec, TypeVar

import numpy as np

from hueflight.errors import ArgumentError

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
LONGEST_VALUE = 40  #: characters of a wrong value that an error quotes
NO_ARRAY = (str, bytes, os.PathLike, Mapping)  #: `Mapping` contains the datasets of xarray


@dataclass(frozen=True)
class Kind:
    """What an argument may be.

    Attributes
    ----------
    words : str
        What it has to be, for errors: "a number".
    accepts : callable
        Says whether a value is of this kind.
    """

    words: str
    accepts: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    """Whether a value is one real number, of Python or NumPy."""
    return _is_array(value) and np.ndim(value) == 0 and np.asarray(value).dtype.kind in "uif"


def _is_whole(value: Any) -> bool:
    try:
        index(value)
    except TypeError:
        return False
    return not isinstance(value, bool | np.bool_)


def _is_array(value: Any) -> bool:
    if value is None or isinstance(value, NO_ARRAY):
        return False
    if isinstance(value, Sequence):
        try:
            np.asarray(value)
        except (TypeError, ValueError):  # rows of different lengths, or datasets in a list
            return False
    return True


def _is_numbers(value: Any) -> bool:
    return _is_array(value) and np.asarray(value).dtype.kind in "uif"


def _is_range(value: Any) -> bool:
    return _is_numbers(value) and np.shape(value) == (2,) and isfinite(sum(value))


NUMBER = Kind("a number", _is_number)
WHOLE = Kind("a whole number", _is_whole)
POSITIVE = Kind("a whole number, 1 or more", lambda value: _is_whole(value) and value >= 1)
COUNTS = Kind("an array of counts", _is_array)
NUMBERS = Kind("a number or an array of numbers", _is_numbers)
RANGE = Kind("two numbers, such as (0.3, 1.5)", _is_range)
SWITCH = Kind("True or False", lambda value: isinstance(value, bool | np.bool_))
TEXT = Kind("text", lambda value: isinstance(value, str))
PATH = Kind(
    "a path, as text or pathlib.Path",
    lambda value: isinstance(value, str | os.PathLike) and bool(os.fspath(value)),
)
PACKETS = Kind(
    "the bytes of packets",
    lambda value: isinstance(value, bytes | bytearray | memoryview | np.ndarray),
)


def listed(kind: type | Kind, words: str) -> Kind:
    """Make the kind of sequences of something.

    Parameters
    ----------
    kind : type or Kind
        Class or kind of each element.
    words : str
        What the sequence is, for errors.

    Returns
    -------
    Kind
        Lists, tuples, other sequences and arrays of one axis, not a text.
    """
    one = _as_kind(kind)

    def accepts(value: Any) -> bool:
        if isinstance(value, np.ndarray):
            return value.ndim == 1 and all(one.accepts(element) for element in value)
        if isinstance(value, str | bytes) or not isinstance(value, Sequence):
            return False
        return all(one.accepts(element) for element in value)

    return Kind(words, accepts)


def takes(
    **kinds: type | Kind,
) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """Decorate a function so that it refuses arguments of other types than these.

    Parameters
    ----------
    **kinds : type or Kind
        Class or kind of each argument, by its name. One whose default is None may be None.

    Returns
    -------
    callable
        The decorator. The function keeps its name, documentation and signature, and raises
        `ArgumentError`.
    """
    wanted = {name: _as_kind(kind) for name, kind in kinds.items()}

    def decorate(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
        shape = signature(function)
        optional = {name for name, one in shape.parameters.items() if one.default is None}

        @wraps(function)
        def checked(*args: Parameters.args, **named: Parameters.kwargs) -> Result:
            try:
                given = shape.bind(*args, **named).arguments
            except TypeError:
                return function(*args, **named)  # Python says which is missing or unknown
            for name, kind in wanted.items():
                if name not in given or (given[name] is None and name in optional):
                    continue
                if not kind.accepts(given[name]):
                    raise ArgumentError(
                        f"{function.__name__}: {name} is {_described(given[name])}: it must be "
                        f"{kind.words}{' or None' if name in optional else ''}"
                    )
            return function(*args, **named)

        return checked

    return decorate


def _as_kind(kind: type | Kind) -> Kind:
    if isinstance(kind, Kind):
        return kind
    article = "an" if kind.__name__[0] in "AEIO" else "a"
    return Kind(f"{article} {kind.__name__}", lambda value: isinstance(value, kind))


def _described(value: Any) -> str:
    """Say what a wrong value is, and quote it where it is short."""
    name = type(value).__name__
    if value is None or isinstance(value, bool):
        return repr(value)
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}, shape {value.shape}"
    if isinstance(value, str | bytes | int | float | os.PathLike | list | tuple):
        text = repr(value)
        if len(text) > LONGEST_VALUE or "\n" in text:
            text = text.splitlines()[0][:LONGEST_VALUE] + "…"
        return f"{text} ({name})"
    return f"of type {name}"
