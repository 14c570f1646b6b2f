# SPDX-License-Identifier: Apache-2.0
"""Mutants of Python in protocol and host: changes of operators, constants, conditions, statements.

Only statements of functions are changed. Declarations, texts, annotations, and what is inside of
formatted strings stay as they are.
"""

from __future__ import annotations

import ast
from pathlib import Path

from mutation.operators import Change, Mutant, name_mutants, starts_of_lines

_COMPARISONS: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
_OPERATIONS: dict[type[ast.operator], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.FloorDiv: "*",
    ast.Mod: "*",
    ast.BitAnd: "|",
    ast.BitOr: "&",
    ast.BitXor: "|",
    ast.LShift: ">>",
    ast.RShift: "<<",
}
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def python_mutants(root: Path, path: Path, /) -> list[Mutant]:
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
    found = _Changes(source).found
    return name_mutants(path.relative_to(root).as_posix(), source, found)


def same_code(one: bytes, other: bytes, /) -> bool:
    """Whether two source texts give the same bytecode.

    Parameters
    ----------
    one, other : bytes
        Source texts that can be compiled.

    Returns
    -------
    bool
        True if they only differ in what is not executed.
    """
    return _outline(compile(one, "", "exec")) == _outline(compile(other, "", "exec"))


def _outline(code: object) -> object:
    """Return a code object without places in the source."""
    if not hasattr(code, "co_code"):
        return type(code), repr(code)
    constants = tuple(map(_outline, code.co_consts))  # pyright: ignore[reportAttributeAccessIssue]
    return code.co_code, constants, code.co_names  # pyright: ignore[reportAttributeAccessIssue]


class _Changes(ast.NodeVisitor):
    """Collects the changes of a file."""

    def __init__(self, source: bytes) -> None:
        self.source = source
        self.starts = starts_of_lines(source)
        self.names: list[str] = []
        self.inside = 0
        self.found: list[Change] = []
        self.visit(ast.parse(source))

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        start = self.starts[node.lineno - 1] + node.col_offset
        return start, self.starts[node.end_lineno - 1] + node.end_col_offset

    def _text(self, node: ast.expr) -> str:
        start, stop = self._span(node)
        return f"({self.source[start:stop].decode()})"

    def _add(self, node: ast.expr | ast.stmt, operator: str, after: str) -> None:
        if self.inside:
            where = ".".join(self.names)
            self.found.append(Change(where, node.lineno, operator, *self._span(node), after))

    def _condition(self, test: ast.expr) -> None:
        self._add(test, "condition", f"(not {self._text(test)})")

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self.names.append(node.name)
        for statement in node.body:
            self.visit(statement)
        self.names.pop()

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        self.names.append(node.name)
        self.inside += 1
        for statement in node.body:
            self.visit(statement)
        self.inside -= 1
        self.names.pop()

    visit_FunctionDef = _function  # noqa: N815
    visit_AsyncFunctionDef = _function  # noqa: N815

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Leave formatted strings, whose parts have no places of their own before Python 3.12."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value:
            self.visit(node.value)

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [self._text(each) for each in (node.left, *node.comparators)]
        signs = [_COMPARISONS[type(each)] for each in node.ops]
        for changed in range(len(signs)):
            after = operands[0]
            for place, (sign, other) in enumerate(signs):
                after += f" {other if place == changed else sign} {operands[place + 1]}"
            self._add(node, "compare", f"({after})")
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if sign := _OPERATIONS.get(type(node.op)):
            after = f"({self._text(node.left)} {sign} {self._text(node.right)})"
            self._add(node, "operator", after)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if sign := _OPERATIONS.get(type(node.op)):
            target = self._text(node.target)[1:-1]
            self._add(node, "operator", f"{target} {sign}= {self._text(node.value)}")
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        sign = " or " if isinstance(node.op, ast.And) else " and "
        self._add(node, "logic", f"({sign.join(map(self._text, node.values))})")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if not isinstance(node.op, ast.UAdd):
            self._add(node, "invert", self._text(node.operand))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self._add(node, "constant", str(not value))
        elif isinstance(value, int):
            self._add(node, "constant", str(1 - value if value in (0, 1) else value + 1))
        elif isinstance(value, float):
            self._add(node, "constant", repr(2 * value) if value else "1.0")

    def visit_If(self, node: ast.If | ast.While | ast.IfExp) -> None:
        self._condition(node.test)
        self.generic_visit(node)

    visit_While = visit_If  # noqa: N815
    visit_IfExp = visit_If  # noqa: N815

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg not in ("strict", "stacklevel"):  # asserts; where a warning points
            self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self._condition(test)
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call):
            self._add(node, "remove", "pass")
        if not isinstance(node.value, ast.Constant):  # a docstring
            self.generic_visit(node)

    def visit_Break(self, node: ast.Break) -> None:
        self._add(node, "loop", "continue")

    def visit_Continue(self, node: ast.Continue) -> None:
        self._add(node, "loop", "break")
