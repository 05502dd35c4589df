"""Mutations of a module: each replaces one piece of its text by another.

Texts of messages, docstrings, type hints, decorators and ``__repr__`` are never mutated.
"""

from __future__ import annotations

import ast
import copy
import difflib
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

#: Folders and modules that are mutated, by the name in the table.
SCOPE = {
    "rig": ("rig",),
    "propulsion": ("propulsion",),
    "swimmer": ("swimmer",),
    "robots": ("robots",),
    "blackbox": ("blackbox",),
    "effects": ("effects",),
    "fitting": ("fitting",),
    "logs": ("logs",),
    "inertial": ("inertial",),
    "tracking": ("tracking",),
    "files": ("files",),
    "results": ("results",),
    "diagnosis": ("diagnosis",),
}
#: Functions whose arguments are messages or change no result.
MESSAGES = {
    "warn", "print", "progress", "Progress", "silent", "note", "echo", "Field", "njit", "TypeVar", "cast",
    "getLogger", "debug", "info", "warning", "filterwarnings", "simplefilter", "namedtuple", "Literal",
}  # fmt: skip
#: Keyword arguments that change no result.
UNOBSERVABLE = {"strict", "encoding", "stacklevel", "description", "slots", "repr"}
COMPARISONS = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
BOUNDARIES = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
ARITHMETIC = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Mult,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One mutation: where it is, of what kind, and the text before and after."""

    path: str
    package: str
    #: Dotted name of the function or class that contains the mutation; empty at the level of the module.
    scope: str
    kind: str
    line: int
    start: int
    end: int
    new: str
    source: str

    @cached_property
    def mutated(self) -> str:
        """The text of the mutated module."""
        raw = self.source.encode()
        return (raw[: self.start] + self.new.encode() + raw[self.end :]).decode()

    @cached_property
    def diff(self) -> list[str]:
        """The changed lines, each with its sign."""
        lines = difflib.unified_diff(self.source.splitlines(), self.mutated.splitlines(), lineterm="", n=0)
        return [line[0] + " " + line[1:].strip() for line in list(lines)[3:] if line[:1] in "+-"]

    @cached_property
    def key(self) -> str:
        """Name that does not change when other parts of the package change."""
        raw = self.source.encode()
        begin = raw.rfind(b"\n", 0, self.start) + 1
        words = (self.path, self.scope, self.kind, raw[begin : self.end].decode(), self.new)
        column = self.start - begin
        return hashlib.sha256("|".join((*words, str(column))).encode()).hexdigest()[:10]

    def rank(self, seed: int) -> str:
        """Return the position of the mutant in the random order of a seed."""
        return hashlib.sha256(f"{seed}|{self.key}".encode()).hexdigest()


def _name(node: ast.AST) -> str:
    """Return the last part of the name of a called function or a decorator."""
    if isinstance(node, ast.Call):
        return _name(node.func)
    if isinstance(node, ast.Attribute):
        return node.attr
    return getattr(node, "id", "")


def is_compiled(node: ast.AST) -> bool:
    """Return whether a function is compiled by numba."""
    return isinstance(node, ast.FunctionDef) and any(_name(d) == "njit" for d in node.decorator_list)


def _is_message(node: ast.AST) -> bool:
    """Return whether a node is a text, a type hint, or a call that changes no result."""
    if isinstance(node, ast.JoinedStr):
        return True
    if isinstance(node, ast.Call):
        return _name(node) in MESSAGES
    return isinstance(node, ast.Raise | ast.Import | ast.ImportFrom)


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the children that may contain mutations."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_params", "bases", "type_comment"):
            continue
        values = value
        if not isinstance(value, list):
            values = [value]
        for child in values:
            if not isinstance(child, ast.AST) or _is_message(child):
                continue
            if isinstance(child, ast.keyword) and child.arg in UNOBSERVABLE:
                continue
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.FunctionDef) and child.name in ("__repr__", "__str__"):
                continue
            yield child


def _is_text(node: ast.AST) -> bool:
    """Return whether an operand is certainly a text or a list."""
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def _replaced(node: ast.AST, **fields: object) -> ast.AST:
    """Return a copy of a node with other fields."""
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _expressions(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:  # noqa: C901
    """Yield kind and replacement of each mutation of an expression."""
    if isinstance(node, ast.Compare):
        for kind, table in (("comparison", COMPARISONS), ("boundary", BOUNDARIES)):
            other = table.get(type(node.ops[0]))
            if other is not None:
                yield kind, _replaced(node, ops=[other(), *node.ops[1:]])
    elif isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        if not (_is_text(node.left) or _is_text(node.right)):
            yield "arithmetic", _replaced(node, op=ARITHMETIC[type(node.op)]())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "sign", node.operand
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "boolean", node.operand
    elif isinstance(node, ast.BoolOp):
        other = ast.And
        if isinstance(node.op, ast.And):
            other = ast.Or
        yield "boolean", _replaced(node, op=other())
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, bool):
            yield "boolean", ast.Constant(not node.value)
        elif isinstance(node.value, int | float):
            yield "constant", ast.Constant(node.value + 1)
    elif isinstance(node, ast.Call) and len(node.args) > 1 and _name(node) not in ("isinstance", "getattr"):
        first, second = node.args[:2]
        if ast.dump(first) != ast.dump(second) and not isinstance(first, ast.Starred):
            yield "argument", _replaced(node, args=[second, first, *node.args[2:]])


def _statements(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield kind and new text of each mutation of a statement."""
    if isinstance(node, ast.Return):
        if node.value is not None and not (isinstance(node.value, ast.Constant) and node.value.value is None):
            yield "return value", "return None"
    elif isinstance(node, ast.AugAssign):
        yield "statement", "pass"
        if type(node.op) in ARITHMETIC and not _is_text(node.value):
            yield "arithmetic", ast.unparse(_replaced(node, op=ARITHMETIC[type(node.op)]()))
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        if not _is_message(node.value):
            yield "statement", "pass"
    elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute | ast.Subscript):
        yield "statement", "pass"


def candidates(path: Path, root: Path, package: str) -> list[Mutant]:
    """Return all mutants of a module."""
    source = path.read_text(encoding="utf-8")
    offsets = [0]
    for line in source.encode().splitlines(keepends=True):
        offsets.append(offsets[-1] + len(line))
    found: list[Mutant] = []

    def add(node: ast.AST, scope: str, kind: str, new: str) -> None:
        start = offsets[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        end = offsets[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        name = path.relative_to(root).as_posix()
        found.append(Mutant(name, package, scope, kind, node.lineno, start, end, new, source))  # type: ignore[attr-defined]

    def visit(node: ast.AST, scope: str) -> None:
        if isinstance(node, ast.Raise):
            return
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            scope = f"{scope}.{node.name}".lstrip(".")
        for kind, new in _statements(node):
            add(node, scope, kind, new)
        for kind, changed in _expressions(node):
            add(node, scope, kind, f"({ast.unparse(ast.fix_missing_locations(changed))})")
        for child in _children(node):
            visit(child, scope)

    visit(ast.parse(source), "")
    return found


def population(root: Path) -> list[Mutant]:
    """Return all mutants of the packages in scope."""
    found = []
    for package, folders in SCOPE.items():
        for folder in folders:
            for path in sorted((root / "swimid" / folder).rglob("*.py")):
                if "__pycache__" not in path.parts:
                    found += candidates(path, root, package)
    return found
