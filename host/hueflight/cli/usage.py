# SPDX-License-Identifier: Apache-2.0
"""Messages about command lines that can't be understood, in one sentence each."""

from __future__ import annotations

from difflib import get_close_matches
from inspect import Parameter
from typing import get_args

from cyclopts.exceptions import (
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

PROGRAM = "hueflight"
#: what a value of a type is called
NEEDED = {float: "a number", int: "a whole number", bool: "yes or no"}


def explain(error: CycloptsError) -> str:
    """Say what is wrong with a command line, and which help describes it.

    Parameters
    ----------
    error : CycloptsError
        What the parser found.

    Returns
    -------
    str
        One sentence.
    """
    command = " ".join([PROGRAM, *(error.command_chain or ())])
    return f"{_what(error)} ({command} --help lists {_listed(error)})"


def _listed(error: CycloptsError) -> str:
    return "the commands" if isinstance(error, UnknownCommandError) else "its arguments"


def _what(error: CycloptsError) -> str:
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        return _missing(error)
    if isinstance(error, UnusedCliTokensError):
        return _unused(error)
    if isinstance(error, UnknownCommandError):
        word = (error.unused_tokens or [""])[0]
        known = [] if error.app is None else [name for name in error.app if name[0] != "-"]
        near = get_close_matches(word, known, n=1)
        choice = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}"
        return f"there is no command {word!r}; {choice}"
    if isinstance(error, UnknownOptionError):
        typed = error.token.keyword or error.token.value
        known = [name for argument in error.argument_collection for name in argument.names]
        near = get_close_matches(typed, known, n=1)
        return f"there is no option {typed}" + (f"; did you mean {near[0]}?" if near else "")
    if isinstance(error, CoercionError) and error.token is not None:
        kinds = [error.target_type, *get_args(error.target_type)]
        needed = next((NEEDED[kind] for kind in kinds if kind in NEEDED), None)
        if needed is not None:
            return f"{error.token.keyword or 'argument'} {error.token.value}: give {needed}"
    return str(error).rstrip(".").replace(". Choose", "; choose")


def _unused(error: UnusedCliTokensError) -> str:
    """Words that belong to nothing; after an option and its value, they may be more values."""
    extra, typed = list(error.unused_tokens or ()), list(error.root_input_tokens or ())
    said = f"{' '.join(extra)!r} is more than the command takes"
    starts = range(2, len(typed) - len(extra) + 1)
    at = next((start for start in starts if typed[start : start + len(extra)] == extra), None)
    if at is None or not typed[at - 2].startswith("--") or typed[at - 1].startswith("--"):
        return said
    option, values = typed[at - 2], [typed[at - 1], *extra]
    repeated = " ".join(f"{option} {value}" for value in values)
    return f"{said}; an option that takes several values is repeated before each: {repeated}"


def _missing(error: MissingArgumentError) -> str:
    argument = error.argument
    assert argument is not None
    positional = argument.field_info.kind in (
        Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD, Parameter.VAR_POSITIONAL
    )  # fmt: skip
    if positional and not error.keyword:
        return f"{argument.name.lstrip('-').upper()} is missing"
    name = error.keyword or argument.name
    expected, got = argument.token_count()[0], len(error.tokens_so_far or ())
    if expected > 1:
        return f"{name} takes {expected} values, but {got} {'is' if got == 1 else 'are'} given"
    return f"{name} needs a value" if error.keyword else f"the option {name} is missing"
