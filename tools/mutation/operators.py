# SPDX-License-Identifier: Apache-2.0
"""Mutants of a source file, and the changes that are made in gateware, found in its syntax tree."""

from __future__ import annotations

import ast
import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

_COMPARISONS = {
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
}
_OPERATIONS = {
    ast.BitAnd: "|",
    ast.BitOr: "&",
    ast.BitXor: "|",
    ast.Add: "-",
    ast.Sub: "+",
    ast.LShift: ">>",
    ast.RShift: "<<",
}
_NOT_HARDWARE = ("__init__", "__post_init__")
"""Functions that declare ports and check arguments: their errors end an elaboration."""


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Parameters
    ----------
    path : str
        File, relative to the root of the repository.
    line : int
        Line of the change.
    where : str
        Function that contains it.
    operator : str
        Kind of change.
    before, after : str
        Source text before and after the change.
    start, stop : int
        Bytes of the file that the change replaces.
    key : str
        Name that stays the same while the function's other text changes.
    """

    path: str
    line: int
    where: str
    operator: str
    before: str
    after: str
    start: int
    stop: int
    key: str

    def apply(self, source: bytes) -> bytes:
        """Return the file's content with the change."""
        return source[: self.start] + self.after.encode() + source[self.stop :]


@dataclass(frozen=True)
class Change:
    """Where and how a source text is changed.

    Parameters
    ----------
    where : str
        Function.
    line : int
        Line of the change.
    operator : str
        Kind of change.
    start, stop : int
        Bytes that are replaced.
    after : str
        New text.
    """

    where: str
    line: int
    operator: str
    start: int
    stop: int
    after: str


def name_mutants(name: str, source: bytes, changes: Iterable[Change], /) -> list[Mutant]:
    """Return the mutants that changes make of a file, each with a key of its own.

    Parameters
    ----------
    name : str
        Path of the file, relative to the root of the repository.
    source : bytes
        Content of the file.
    changes : iterable of Change
        The changes.

    Returns
    -------
    list of Mutant
        In the order of the changes.
    """
    found: list[Mutant] = []
    seen: Counter[str] = Counter()
    for change in changes:
        before = source[change.start : change.stop].decode()
        text = "\0".join((name, change.where, change.operator, before, change.after))
        seen[text] += 1
        key = hashlib.sha256(f"{text}\0{seen[text]}".encode()).hexdigest()[:10]
        found.append(
            Mutant(
                name,
                change.line,
                change.where,
                change.operator,
                before,
                change.after,
                change.start,
                change.stop,
                key,
            )
        )
    return found


def starts_of_lines(source: bytes, /) -> list[int]:
    """Return where each line begins, and where the last one ends."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    return starts


def mutants_of(root: Path, path: Path, /) -> list[Mutant]:
    """Return all mutants of a file of the gateware, in the order of the source.

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
    return name_mutants(path.relative_to(root).as_posix(), source, _all_changes(source))


def _all_changes(source: bytes) -> Iterator[Change]:
    starts = starts_of_lines(source)
    for where, function in _functions(ast.parse(source)):
        for node, operator, after in _changes(function, source, starts):
            start = starts[node.lineno - 1] + node.col_offset
            stop = _end(node, starts)
            if operator == "remove":
                _, stop = _with_comma(source, start, stop)
            yield Change(where, node.lineno, operator, start, stop, after)


def _end(node: ast.expr, starts: list[int]) -> int:
    """Place one past the last byte of a node."""
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    return starts[node.end_lineno - 1] + node.end_col_offset


def _functions(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield the functions that make hardware, with their qualified names."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            yield node.name, node
        elif isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, ast.FunctionDef) and inner.name not in _NOT_HARDWARE:
                    yield f"{node.name}.{inner.name}", inner


def _changes(
    function: ast.FunctionDef, source: bytes, starts: list[int]
) -> Iterator[tuple[ast.expr, str, str]]:
    """Yield the changes within a function: node, kind, new text."""

    def text(node: ast.expr) -> str:
        start = starts[node.lineno - 1] + node.col_offset
        return source[start : _end(node, starts)].decode()

    for statement in function.body:
        for node in ast.walk(statement):
            match node:
                case ast.Compare(left=left, ops=[operator], comparators=[right]):
                    if sign := _COMPARISONS.get(type(operator)):
                        yield node, "compare", f"(({text(left)}) {sign} ({text(right)}))"
                case ast.BinOp(left=left, op=operator, right=right):
                    if sign := _OPERATIONS.get(type(operator)):
                        yield node, "operator", f"(({text(left)}) {sign} ({text(right)}))"
                case ast.UnaryOp(op=ast.Invert(), operand=operand):
                    yield node, "invert", f"({text(operand)})"
                case ast.Constant(value=int(value)) if not isinstance(value, bool):
                    yield node, "constant", str(1 - value if value in (0, 1) else value + 1)
                case ast.Call(func=ast.Name(id="Mux"), args=[choice, high, low]):
                    yield node, "choice", f"Mux({text(choice)}, {text(low)}, {text(high)})"
                case ast.Call(func=ast.Attribute(attr="If" | "Elif"), args=[condition]):
                    yield condition, "condition", f"~({text(condition)}).bool()"
                case ast.List(elts=[_, _, *_]):
                    for element in node.elts:
                        if _is_assignment(element):
                            yield element, "remove", ""


def _is_assignment(node: ast.expr) -> bool:
    return (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "eq"
    )


def _with_comma(source: bytes, start: int, stop: int) -> tuple[str, int]:
    """Extend a list's element by the comma behind it."""
    after = stop
    while source[after : after + 1].isspace():
        after += 1
    stop = after + 1 if source[after : after + 1] == b"," else stop
    return source[start:stop].decode(), stop
