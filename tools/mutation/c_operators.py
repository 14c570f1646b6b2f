# SPDX-License-Identifier: Apache-2.0
"""Mutants of the compiled kernels: changes of operators, constants and conditions in C.

The sources are split into tokens, not parsed. An operator counts as binary if it stands between
spaces, as the sources are written, so that pointers and signs are left alone. Lines of the
preprocessor, declarations outside functions, and texts are not changed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mutation.operators import Change, Mutant, name_mutants

_TOKEN = re.compile(
    rb"""
    (?P<skip> \s+ | /\*.*?\*/ | //[^\n]* )
  | (?P<line> \#(?:[^\n]*\\\n)*[^\n]* )
  | (?P<text> "(?:\\.|[^"\\])*" | '(?:\\.|[^'\\])*' )
  | (?P<number> (?:0[xX][0-9a-fA-F]+ | \d+\.?\d*(?:[eE][+-]?\d+)? | \.\d+) [uUlLfF]* )
  | (?P<name> [A-Za-z_]\w* )
  | (?P<sign> <<= | >>= | \+\+ | -- | -> | && | \|\| | << | >> | [<>=!+\-*/%&|^]= | . )
    """,
    re.VERBOSE | re.DOTALL,
)
_BINARY = dict(
    pair.split()
    for pair in (
        *("== !=", "!= ==", "< <=", "<= <", "> >=", ">= >", "&& ||", "|| &&"),
        *("+ -", "- +", "* /", "/ *", "% *", "<< >>", ">> <<", "& |", "| &", "^ |"),
        *("+= -=", "-= +=", "*= /=", "/= *=", "%= *=", "<<= >>=", ">>= <<="),
        *("&= |=", "|= &=", "^= |="),
    )
)
_COMPARISONS = ("==", "!=", "<", "<=", ">", ">=")
_NUMBER = re.compile(r"(0[xX][0-9a-fA-F]+|\d+)([uUlL]*)|(\d*\.?\d*(?:[eE][+-]?\d+)?)([fFlL]?)")


@dataclass(frozen=True)
class Token:
    """A token of C and its place in the file."""

    kind: str
    text: str
    start: int
    stop: int
    line: int


def tokens(source: bytes, /) -> list[Token]:
    """Return the tokens of a source, without comments and lines of the preprocessor.

    Parameters
    ----------
    source : bytes
        Text in C.

    Returns
    -------
    list of Token
        In order.
    """
    found, line = [], 1
    for match in _TOKEN.finditer(source):
        kind = match.lastgroup or ""
        if kind not in ("skip", "line"):
            found.append(Token(kind, match.group().decode(), match.start(), match.end(), line))
        line += match.group().count(b"\n")
    return found


def c_mutants(root: Path, path: Path, /) -> list[Mutant]:
    """Return all mutants of a file, in the order of the source.

    Parameters
    ----------
    root : Path
        Root of the repository.
    path : Path
        The file.

    Returns
    -------
    list of Mutant
        Each has a unique key.
    """
    source = path.read_bytes()
    changes = (
        change
        for where, body in _functions(tokens(source))
        for change in _changes(where, body, source)
    )
    return name_mutants(path.relative_to(root).as_posix(), source, changes)


def _functions(every: list[Token]) -> Iterator[tuple[str, list[Token]]]:
    """Yield the bodies of functions, with their names."""
    at = 0
    while at < len(every):
        if every[at].text != "{":
            at += 1
            continue
        end = _closing(every, at)
        if at and every[at - 1].text == ")":
            yield every[_opening(every, at - 1) - 1].text, every[at + 1 : end]
        at = end + 1


def _closing(every: list[Token], at: int) -> int:
    """Return the place of what closes a bracket."""
    opening = every[at].text
    closing = {"{": "}", "(": ")"}[opening]
    depth = 0
    for place in range(at, len(every)):
        depth += (every[place].text == opening) - (every[place].text == closing)
        if not depth:
            return place
    return len(every)


def _opening(every: list[Token], at: int) -> int:
    """Return the place of what opens a bracket."""
    depth = 0
    for place in range(at, -1, -1):
        depth += (every[place].text == ")") - (every[place].text == "(")
        if not depth:
            return place
    return 0


def _changes(where: str, body: list[Token], source: bytes) -> Iterator[Change]:
    """Yield the changes within a function."""

    def change(token: Token, operator: str, after: str) -> Change:
        return Change(where, token.line, operator, token.start, token.stop, after)

    for place, token in enumerate(body):
        if token.kind == "number":
            yield change(token, "constant", _other_number(token.text))
        elif token.text == "!":
            yield change(token, "invert", "")
        elif token.text == "if" and place + 1 < len(body):
            first, last = body[place + 1], body[_closing(body, place + 1)]
            test = source[first.start : last.stop].decode()
            yield Change(where, token.line, "condition", first.start, last.stop, f"(!{test})")
        elif token.text in _BINARY and _between_spaces(source, token):
            kind = "compare" if token.text in _COMPARISONS else "operator"
            kind = "logic" if token.text in ("&&", "||") else kind
            yield change(token, kind, _BINARY[token.text])


def _between_spaces(source: bytes, token: Token) -> bool:
    around = source[token.start - 1 : token.start], source[token.stop : token.stop + 1]
    return all(each.isspace() for each in around)


def _other_number(text: str) -> str:
    """Return a number near another one: 1 for 0 and the reverse, the next one, or twice as much."""
    match = _NUMBER.fullmatch(text)
    assert match, text
    whole, suffix, real, real_suffix = match.groups()
    if whole:
        value = int(whole, 0)
        return f"{1 - value if value in (0, 1) else value + 1}{suffix}"
    return f"{2 * float(real) or 1.0!r}{real_suffix}"
