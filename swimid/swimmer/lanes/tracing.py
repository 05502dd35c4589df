"""Equations of an engine as a list of operations, and the source text of a module that computes them.

An engine is the compiled equations of motion of a robot. Its compiled functions are Python functions. When
they are called with symbols instead of numbers, they run through their loops over links and elements once,
and record a list of sums and products. Operations with input entries that are always 0 or 1 are removed. An
engine must be written for this: it may branch on a value only by
:func:`swimid.swimmer.planar.engine.positive`, ``max``, ``min`` and ``abs``.

The module integrates a batch of simulations by a fourth-order Runge-Kutta method. The operations are the body
of a loop ``for lane in range(LANES)`` over one flat work array, which the compiler vectorises. It does so
only if the loop writes no second array, all indices are literal, and no statement leaves the loop early.
Therefore :func:`text` copies inputs and results in other loops.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic

from swimid.swimmer.planar.engine import BROKEN

#: Coefficients of polynomials for sine and cosine between -45 and 45 degrees (S. Moshier, Cephes: sin.c,
#: double precision).
SINE = (
    1.58962301576546568060e-10,
    -2.50507477628578072866e-8,
    2.75573136213857245213e-6,
    -1.98412698295895385996e-4,
    8.33333333332211858878e-3,
    -1.66666666666666307295e-1,
)
COSINE = (
    -1.13585365213876817300e-11,
    2.08757008419747316778e-9,
    -2.75573141792967388112e-7,
    2.48015872888517045348e-5,
    -1.38888888888730564116e-3,
    4.16666666666665929218e-2,
)
#: The angle pi / 2, rad, as a sum of three numbers. They are short enough for exact products (Cody and Waite
#: 1980).
QUARTER = (1.5707962512969971, 7.549789415861596e-08, 5.390302858158119e-15)
#: Logarithm of 2 as a sum of two numbers. The first number ends in zero bits (Cephes: exp.c, double
#: precision).
LOG_2 = (6.93145751953125e-1, 1.42860682030941723212e-6)
#: Taylor coefficients of the exponential, for arguments up to half the logarithm of 2, and of ``artanh(x) /
#: x`` in powers of x^2, for x^2 up to ``(sqrt(2) - 1)^2 / (sqrt(2) + 1)^2``. The first omitted term is below
#: 1e-17.
EXPONENTIAL = tuple(1.0 / math.factorial(k) for k in range(13, -1, -1))
LOGARITHM = tuple(1.0 / (2 * k + 1) for k in range(10, -1, -1))
#: Minimum and maximum arguments of the exponential for which the result is a normal double.
LEAST, MOST = -708.0, 709.0
#: The number 1.5 * 2^52. A number to which it is added, and from which it is then subtracted, is rounded to
#: an integer.
ROUNDER = 6755399441055744.0


class Tracer:
    """List of operations on symbols, in the order of their first use. Equal operations are listed once.

    Attributes
    ----------
    operations : list of Symbol
    """

    def __init__(self) -> None:
        self.operations: list[Symbol] = []
        self._known: dict[tuple[Any, ...], Symbol] = {}

    def symbol(self, kind: str, *of: Symbol | float | int) -> Symbol:
        """Return the symbol for the result of an operation."""
        key = (kind, *(a.number if isinstance(a, Symbol) else (repr(a),) for a in of))
        if key not in self._known:
            self._known[key] = Symbol(self, kind, of, len(self.operations))
            self.operations.append(self._known[key])
        return self._known[key]


class Symbol:
    """Result of an operation, or an input of the equations with its index.

    Inputs are ``state``, ``row`` (of the drive array), ``table``, ``number`` (of the forces of effects) and
    ``elapsed`` (time since the start).

    Raises
    ------
    TypeError
        If an ``if`` statement needs the value of the symbol, which cannot be traced.
    """

    __slots__ = ("kind", "number", "of", "tracer")

    def __init__(self, tracer: Tracer, kind: str, of: tuple[Any, ...], number: int) -> None:
        self.tracer, self.kind, self.of, self.number = tracer, kind, of, number

    def __add__(self, other: Symbol | float) -> Symbol | float:
        if _is(other, 0.0):
            return self
        return self.tracer.symbol("+", self, other)

    __radd__ = __add__

    def __sub__(self, other: Symbol | float) -> Symbol | float:
        if other is self:
            return 0.0
        if _is(other, 0.0):
            return self
        return self.tracer.symbol("-", self, other)

    def __rsub__(self, other: float) -> Symbol | float:
        if _is(other, 0.0):
            return -self
        return self.tracer.symbol("-", other, self)

    def __mul__(self, other: Symbol | float) -> Symbol | float:
        if _is(other, 0.0):
            return 0.0
        if _is(other, 1.0):
            return self
        if _is(other, -1.0):
            return -self
        return self.tracer.symbol("*", self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Symbol | float) -> Symbol | float:
        if _is(other, 1.0):
            return self
        return self.tracer.symbol("/", self, other)

    def __rtruediv__(self, other: float) -> Symbol | float:
        if _is(other, 0.0):
            return 0.0
        return self.tracer.symbol("/", other, self)

    def __neg__(self) -> Symbol | float:
        if self.kind == "neg":
            return self.of[0]
        return self.tracer.symbol("neg", self)

    def __pow__(self, power: Symbol | float) -> Any:
        if isinstance(power, int) and power > 0:
            return math.prod([self] * power)
        return _exponential(power * _logarithm(self))

    def __abs__(self) -> Symbol:
        return self.tracer.symbol("abs", self)

    def _given(self, other: object) -> bool:
        """Return True for an entry of an input array: a symbol stands for a positive value, not for zero."""
        if self.kind == "table" and _is(other, 0.0):
            return True
        raise TypeError("the equations ask for a value: write positive(), max() or min()")

    __gt__ = __ne__ = _given

    def __le__(self, other: object) -> bool:
        return not self._given(other)

    __eq__ = __le__

    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        raise TypeError("the equations ask for a value: write positive(), max() or min()")


class Angle:
    """Angle that is represented by its sine and cosine."""

    __slots__ = ("cosine", "sine")

    def __init__(self, sine: Any, cosine: Any) -> None:
        self.sine, self.cosine = sine, cosine


def _is(value: object, number: float) -> bool:
    return isinstance(value, (int, float)) and value == number


def _tracer(*values: object) -> Tracer | None:
    return next((v.tracer for v in values if isinstance(v, Symbol)), None)


def positive(asked: Any, then: Any, otherwise: Any) -> Any:
    """Return ``then`` where ``asked`` is above 0, and ``otherwise`` elsewhere."""
    if then is otherwise:
        return then
    if isinstance(asked, Symbol):
        return asked.tracer.symbol("positive", asked, then, otherwise)
    return then if asked > 0.0 else otherwise


def _traced(kind: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that computes with numbers, and records an operation of this kind for symbols."""

    def apply(*values: Any) -> Any:
        tracer = _tracer(*values)
        if tracer is None:
            return function(*values)
        return tracer.symbol(kind, *values)

    return apply


_largest, _smallest, _root = _traced("max", max), _traced("min", min), _traced("sqrt", math.sqrt)


def sine_and_cosine(x: Any) -> tuple[Any, Any]:
    """Return sine and cosine of an angle of up to some thousand rotations, with an error below 2.3e-16."""
    if isinstance(x, Angle):
        return x.sine, x.cosine
    if not isinstance(x, Symbol):
        return math.sin(x), math.cos(x)
    quarter: Any = (x * (2.0 / math.pi) + ROUNDER) - ROUNDER
    rest = ((x - quarter * QUARTER[0]) - quarter * QUARTER[1]) - quarter * QUARTER[2]
    # the quadrant is 0, 1, 2 or 3
    quadrant = quarter - 4.0 * (((quarter * 0.25 - 0.375) + ROUNDER) - ROUNDER)
    square: Any = rest * rest
    sine = rest * square * _horner(SINE, square) + rest
    cosine = square * square * _horner(COSINE, square) + (1.0 - 0.5 * square)
    odd = 0.5 - abs(abs(quadrant - 2.0) - 1.0)
    sine, cosine = positive(odd, cosine, sine), positive(odd, sine, cosine)
    return positive(quadrant - 1.5, -sine, sine), positive(1.0 - abs(quadrant - 1.5), -cosine, cosine)


def _facing(frame: Any, base: Any, turn: Any) -> Angle:
    """Return the angle that :func:`swimid.swimmer.planar.engine.facing` returns."""
    _, c, s = frame
    cosine, sine = turn
    return Angle(s * cosine + c * sine, c * cosine - s * sine)


def _exponential(x: Any) -> Any:
    """Return the exponential for results from e^-708 to e^709, with a relative error below 3e-16.

    It is a power of two multiplied by the Taylor series of the remaining factor.
    """
    if not isinstance(x, Symbol):
        return math.exp(x)
    inside = _largest(_smallest(x, MOST), LEAST)
    rounded = inside * (1.0 / math.log(2.0)) + ROUNDER
    whole: Any = rounded - ROUNDER
    rest = (inside - whole * LOG_2[0]) - whole * LOG_2[1]
    return _horner(EXPONENTIAL, rest) * x.tracer.symbol("two to", rounded)


def _logarithm(x: Any) -> Any:
    """Return the logarithm of a positive normal number, with an absolute or relative error below 3e-16."""
    if not isinstance(x, Symbol):
        return math.log(x)
    power, rest = (x.tracer.symbol(kind, x) for kind in ("exponent", "mantissa"))
    above = rest - math.sqrt(2.0)
    power, rest = positive(above, power + 1.0, power), positive(above, 0.5 * rest, rest)
    ratio = (rest - 1.0) / (rest + 1.0)
    series = 2.0 * ratio * _horner(LOGARITHM, ratio * ratio)
    return power * LOG_2[0] + (series + power * LOG_2[1])


def _horner(coefficients: tuple[float, ...], x: Any) -> Any:
    """Return the value of a polynomial, whose coefficients begin with that of the highest power."""
    value: Any = coefficients[0]
    for c in coefficients[1:]:
        value = value * x + c
    return value


#: Replacement of the module ``math`` for symbols.
MATH = SimpleNamespace(
    sqrt=_root,
    exp=_exponential,
    log=_logarithm,
    sin=lambda x: sine_and_cosine(x)[0],
    cos=lambda x: sine_and_cosine(x)[1],
    pi=math.pi,
    nan=math.nan,
    inf=math.inf,
)


def on_symbols(function: Any) -> Callable[..., Any]:
    """Convert a compiled function, and all functions that it calls, to Python functions of symbols."""
    return _plain(function, {})


def _plain(function: Any, known: dict[Any, Any]) -> Any:
    if function in known:
        return known[function]
    # cfunc compiles the function of a force, and its result is not a Dispatcher
    text = function.py_func if isinstance(function, Dispatcher) else function.__wrapped__
    names: dict[str, Any] = {}
    known[function] = FunctionType(text.__code__, names, text.__name__, text.__defaults__)
    for name, value in text.__globals__.items():
        names[name] = _plain(value, known) if isinstance(value, Dispatcher) else value
    names.update(math=MATH, max=_largest, min=_smallest, positive=positive, facing=_facing)
    return known[function]


def array(tracer: Tracer, kind: str, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Return an array of input symbols, numbered from 0."""
    inputs = np.empty(shape, dtype=object)
    inputs.reshape(-1)[:] = [tracer.symbol(kind, i) for i in range(inputs.size)]
    return inputs


#: Number of simulations in a batch. Eight doubles fill one register of AVX-512, two of AVX2, or four of NEON.
LANES = 8


@dataclass(frozen=True)
class Traced:
    """A traced engine, which is the input of :func:`text`.

    Attributes
    ----------
    operations : sequence of Symbol
    rates : sequence of Symbol or float, length of the state
    settled : (sequence of Symbol, sequence of Symbol or float)
        Operations on the state after a step, and the corrected state. Both are empty without a correction.
    parameters : int
        Number of inputs from the input arrays of the engine.
    width : int
        Number of entries in a row of the drive array.
    """

    operations: Sequence[Symbol]
    rates: Sequence[Symbol | float]
    settled: tuple[Sequence[Symbol], Sequence[Symbol | float]]
    parameters: int
    width: int

    @property
    def size(self) -> int:
        """Length of the state vector."""
        return len(self.rates)


_MODULE = '''"""Generated by swimid: {lanes} runs of one robot side by side."""

import math

import numba
{imports}
SIGNATURE = "{signature}"


@numba.njit(nogil=True, error_model="numpy", fastmath={{"contract", "nsz"}}, boundscheck=False, cache=True)
def integrate(start, step, {tables}, shared, steps, parameters, states, rates, w):
    count = states.shape[0]
    for q in range({numbers}):
        w[{parameter} + q] = parameters[q]
    for q in range({states}):
        w[{here} + q] = start[q]
        w[{total} + q] = start[q]
        w[{stage} + q] = start[q]
    for lane in range({lanes}):
        w[{step} + lane] = step[lane]
    for evaluation in range(4 * steps + 1):
        part = evaluation & 3
        whole = evaluation >> 2
        half = 1.0 if part == 2 else 0.5
        share = 1.0 / 3.0 if part == 1 or part == 2 else 1.0 / 6.0
        if part == 1 or part == 3 or evaluation == 0:
            n = (evaluation + 1) >> 1
            if shared:
                n0 = min(n, table0.shape[0] - 1)
{shared}
            else:
{rows}
        for lane in range({lanes}):
{rates}
        if part == 0:
            for lane in range({lanes}):
{check}
            for lane in range(count):
                for q in range({size}):
                    states[lane, whole, q] = w[{here} + {lanes} * q + lane]
                    rates[lane, whole, q] = w[{rate} + {lanes} * q + lane]
        if part == 3:
{settled}
            for q in range({states}):
                w[{here} + q] = w[{total} + q]
                w[{stage} + q] = w[{total} + q]
'''


_BITS = """
from swimid.swimmer.lanes.tracing import bits, double
"""
#: Operations on the bits of a positive normal double. A double has 52 bits of mantissa below the exponent,
#: which has an offset of 1023. After 1.5 * 2^52 is added to a number, its last bits are an integer. The same
#: holds for 2^52 (0x433).
_OF_BITS = {
    "two to": "double((bits({0}) + 1023) << 52)",
    "exponent": "double((bits({0}) >> 52) | 0x4330000000000000) - 4503599627371519.0",
    "mantissa": "double((bits({0}) & 0xFFFFFFFFFFFFF) | 0x3FF0000000000000)",
}


#: Program text of each operation, except division.
_TEXTS = {
    "+": "{0} + {1}",
    "-": "{0} - {1}",
    "*": "{0} * {1}",
    "positive": "{1} if {0} > 0.0 else {2}",
    "max": "{0} if {0} > {1} else {1}",
    "min": "{0} if {0} < {1} else {1}",
    "neg": "-{0}",
    "abs": "abs({0})",
    "sqrt": "math.sqrt({0})",
    **_OF_BITS,
}


def length(traced: Traced) -> int:
    """Return the length of the work array."""
    return LANES * (4 * traced.size + 2 + traced.width + traced.parameters)


def text(traced: Traced) -> str:
    """Return the text of the module of a traced engine.

    Its function is ``integrate(start, step, table0, ..., shared, steps, parameters, states, rates, work)``:

    - ``start``, ``step`` and ``parameters`` are flat. The simulation is the last axis.
    - ``table0`` and so on are drive arrays of shape (2 steps + 1 or fewer, width).
      The last row holds for all later times. If ``shared`` is true, all simulations read the first array.
    - ``states`` and ``rates`` have shape (simulations, steps + 1, size). They are NaN after a breakdown.
    """
    size = traced.size
    here, total, stage, rate = (LANES * size * k for k in range(4))
    step = 4 * LANES * size
    row = step + LANES
    parameter = row + LANES * traced.width
    elapsed = parameter + LANES * traced.parameters
    slots = {"state": stage, "row": row, "table": parameter, "number": parameter, "elapsed": elapsed}

    def at(first: int, place: int) -> str:
        return f"w[{first + LANES * place} + lane]"

    lines = _operations(traced.operations, lambda x: at(slots[x.kind], x.of[0]))
    for j, x in enumerate(traced.rates):
        lines += [
            f"{at(rate, j)} = {_value(x)}",
            f"{at(stage, j)} = {at(here, j)} + half * {at(step, 0)} * {_value(x)}",
            f"{at(total, j)} = {at(total, j)} + share * {at(step, 0)} * {_value(x)}",
        ]
    check = ["far = 0.0"]
    check += [f"far = abs({at(here, j)}) if abs({at(here, j)}) > far else far" for j in range(size)]
    check += ["gone = 0.0 * (" + " + ".join(at(rate, j) for j in range(size)) + ")"]
    check += [f"gone = gone if far < {BROKEN!r} else math.nan"]
    check += [f"{at(first, j)} = {at(first, j)} + gone" for first in (here, total, rate) for j in range(size)]
    ends = _operations(traced.settled[0], lambda x: at(total, x.of[0]))
    ends += [f"{at(total, j)} = {_value(x)}" for j, x in enumerate(traced.settled[1])]
    used = sorted(x.of[0] for x in traced.operations if x.kind == "row")
    rows = []
    for lane in range(LANES):
        rows.append(f"n{lane} = min(n, table{lane}.shape[0] - 1)")
        rows += [f"w[{row + LANES * q + lane}] = table{lane}[n{lane}, {q}]" for q in used]
    alike: list[str] = []
    for q in used:
        alike += [f"number = table0[n0, {q}]", f"for lane in range({LANES}):", f"    {at(row, q)} = number"]
    kinds = {x.kind for x in traced.operations}
    if "elapsed" in kinds:
        late = [f"for lane in range({LANES}):", f"    {at(elapsed, 0)} = 0.5 * n * {at(step, 0)}"]
        rows, alike = [*rows, *late], [*alike, *late]
    return _MODULE.format(
        imports=_BITS if kinds & _OF_BITS.keys() else "",
        lanes=LANES,
        signature="void("
        + ", ".join(
            ["f8[::1]"] * 2
            + ["f8[:, ::1]"] * LANES
            + ["b1", "i8", "f8[::1]", "f8[:, :, ::1]", "f8[:, :, ::1]", "f8[::1]"]
        )
        + ")",
        tables=", ".join(f"table{lane}" for lane in range(LANES)),
        numbers=LANES * traced.parameters,
        states=LANES * size,
        size=size,
        parameter=parameter,
        here=here,
        total=total,
        stage=stage,
        rate=rate,
        step=step,
        rows=_indented(rows, 16),
        shared=_indented(alike or ["pass"], 16),
        rates=_indented(lines, 12),
        check=_indented(check, 16),
        settled=f"            for lane in range({LANES}):\n" + _indented(ends, 16) if ends else "",
    )


def _indented(lines: Sequence[str], by: int) -> str:
    """Return lines as one text, indented by a number of blanks."""
    return "\n".join(" " * by + line for line in lines)


def _value(x: Symbol | float) -> str:
    """Return the program text of a symbol or a number."""
    if isinstance(x, Symbol):
        return f"x{x.number}"
    return "math.nan" if x != x else repr(float(x))


def _operations(operations: Sequence[Symbol], given: Any) -> list[str]:
    """Return one line of program text for each operation.

    Parameters
    ----------
    operations : sequence of Symbol
    given : callable
        Function from an input symbol to its program text.
    """
    lines, divided = [], set()
    for x in operations:
        of = [_value(a) if isinstance(a, (Symbol, float)) else str(a) for a in x.of]
        if x.kind in _TEXTS:
            line = _TEXTS[x.kind].format(*of)
        elif x.kind == "/":
            line = f"{of[0]} / {of[1]}"
            if isinstance(x.of[1], Symbol):
                # several quotients may have one divisor, so compute its reciprocal once
                line = f"{of[0]} * i{of[1]}"
                if of[1] not in divided:
                    lines.append(f"i{of[1]} = 1.0 / {of[1]}")
                    divided.add(of[1])
        else:
            line = given(x)
        lines.append(f"x{x.number} = {line}")
    return lines


@intrinsic
def bits(typing: Any, number: Any) -> Any:
    """Return the bits of a double as an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


@intrinsic
def double(typing: Any, number: Any) -> Any:
    """Return the double whose bits are those of an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), generate
