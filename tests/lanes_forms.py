"""Other forms of the engines: the traced operations, and the generated module as Python."""

from __future__ import annotations

import math
import operator
import re
from types import SimpleNamespace
from typing import Any

import numpy as np

from swimid.swimmer import lanes
from swimid.swimmer.lanes import Kernel, Symbol

ACTS = {
    "two to": lambda x: 2.0 ** (x - lanes.ROUNDER),
    "exponent": lambda x: math.frexp(x)[1] - 1.0,
    "mantissa": lambda x: 2.0 * math.frexp(x)[0],
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "neg": operator.neg,
    "abs": abs,
    "sqrt": math.sqrt,
    "max": max,
    "min": min,
    "positive": lambda asked, then, otherwise: then if asked > 0.0 else otherwise,
}


def rate(kernel: Kernel, state: np.ndarray, row: np.ndarray, tables: dict[str, Any]) -> np.ndarray:
    """Return the rate of a state, computed from the traced operations."""
    inputs = {"state": state, "row": row.reshape(-1), "table": kernel.numbers(tables)}
    known: dict[int, float] = {}

    def value(x: Any) -> float:
        return known[x.number] if isinstance(x, Symbol) else x

    for x in kernel.equations.operations:
        if x.kind in inputs:
            known[x.number] = float(inputs[x.kind][x.of[0]])
        else:
            known[x.number] = ACTS[x.kind](*(value(a) for a in x.of))
    return np.array([value(x) for x in kernel.equations.rates])


def arithmetic(kernel: Kernel) -> tuple[int, int]:
    """Count the instructions of a compiled kernel on packed and on single doubles, on x86-64."""
    names: dict[str, Any] = {}
    exec(lanes.source_of(kernel.equations).replace("cache=True", "cache=False"), names)
    names["integrate"].compile(names["SIGNATURE"])
    assembly = next(iter(names["integrate"].inspect_asm().values()))
    packed, single = (
        len(re.findall(rf"\tv?(?:add|sub|mul|fm\w+|fnm\w+)(?:\d+)?{width}\b", assembly))
        for width in ("pd", "sd")
    )
    return packed, single


def emit(program: list[tuple[Any, ...]]) -> Any:
    """Return a Python function that runs a program of a generated module on the work array."""

    def run(work: np.ndarray, lane: int, *given: float) -> None:
        found: list[Any] = []
        for kind, *of in program:
            if kind == "load":
                found.append(work[of[0] + lane])
                continue
            if kind == "given":
                found.append(given[of[0]])
                continue
            places = of[:1] * (kind == "store")
            values = [found[a] if isinstance(a, int) else a for a in of[len(places) :]]
            if places:
                work[places[0] + lane], result = values[0], None
            else:
                result = ACTS[kind](*values)
            found.append(result)

    return run


def uncompiled(kernel: Kernel) -> Any:
    """Return the generated module as Python, not compiled."""
    text = lanes.source_of(kernel.equations).replace("import numba", "")
    text = text.replace("from swimid.swimmer.lanes import emit", "")
    names: dict[str, Any] = {
        "numba": SimpleNamespace(njit=lambda **_: lambda function: function),
        "emit": emit,
    }
    exec(compile(text, "lanes", "exec"), names)
    return SimpleNamespace(integrate=names["integrate"])
