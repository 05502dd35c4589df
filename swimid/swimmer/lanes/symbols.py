"""The equations of an engine as a list of operations: its own functions, run once on symbols.

The compiled functions of an engine are plain Python underneath. Run on symbols in place of numbers they go
through their loops over links and elements once and leave the straight line of sums and products behind: of
the tables, what is structurally 0 or 1 is folded away. An engine written for this asks no question of a value
but by :func:`swimid.swimmer.choice.positive`, ``max``, ``min`` and ``abs``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

#: Taylor-like polynomials of sine and cosine on a quarter turn (S. Moshier, Cephes: sin.c, double precision).
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
#: Half a turn over two in three parts, each short enough for exact products (Cody and Waite 1980).
QUARTER = (1.5707962512969971, 7.549789415861596e-08, 5.390302858158119e-15)
#: The logarithm of 2 in two parts, the first with zeros at its end (Cephes: exp.c, double precision).
LOG_2 = (6.93145751953125e-1, 1.42860682030941723212e-6)
#: Taylor's series of the exponential up to half the logarithm of 2, and that of ``artanh(x) / x`` in squares
#: up to ``(sqrt(2) - 1)^2 / (sqrt(2) + 1)^2``; the first term left out is below 1e-17.
EXPONENTIAL = tuple(1.0 / math.factorial(k) for k in range(13, -1, -1))
LOGARITHM = tuple(1.0 / (2 * k + 1) for k in range(10, -1, -1))
#: Exponents whose powers are ordinary doubles.
LEAST, MOST = -708.0, 709.0
#: 1.5 * 2^52: adding and taking it away again rounds to a whole number.
ROUNDER = 6755399441055744.0


class Tracer:
    """Operations in the order in which they were first asked for; the same operation is listed once.

    Attributes
    ----------
    operations : list of Symbol
    """

    def __init__(self) -> None:
        self.operations: list[Symbol] = []
        self._known: dict[tuple[Any, ...], Symbol] = {}

    def symbol(self, kind: str, *of: Symbol | float | int) -> Symbol:
        """The symbol of an operation."""
        key = (kind, *(a.number if isinstance(a, Symbol) else (repr(a),) for a in of))
        if key not in self._known:
            self._known[key] = Symbol(self, kind, of, len(self.operations))
            self.operations.append(self._known[key])
        return self._known[key]


class Symbol:
    """The result of an operation, or an input by its place.

    Inputs are ``state``, ``row`` (of the drive), ``table``, ``number`` (what a run brings beside the robot's
    tables) and ``elapsed`` (the time since the start).

    Raises
    ------
    TypeError
        Where its value is asked for: an ``if`` over it cannot be traced.
    """

    __slots__ = ("kind", "number", "of", "tracer")

    def __init__(self, tracer: Tracer, kind: str, of: tuple[Any, ...], number: int) -> None:
        self.tracer, self.kind, self.of, self.number = tracer, kind, of, number

    def __add__(self, other: Symbol | float) -> Symbol | float:
        return self if _is(other, 0.0) else self.tracer.symbol("+", self, other)

    __radd__ = __add__

    def __sub__(self, other: Symbol | float) -> Symbol | float:
        if other is self:
            return 0.0
        return self if _is(other, 0.0) else self.tracer.symbol("-", self, other)

    def __rsub__(self, other: float) -> Symbol | float:
        return -self if _is(other, 0.0) else self.tracer.symbol("-", other, self)

    def __mul__(self, other: Symbol | float) -> Symbol | float:
        if _is(other, 0.0):
            return 0.0
        if _is(other, 1.0) or _is(other, -1.0):
            return self if other == 1.0 else -self
        return self.tracer.symbol("*", self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Symbol | float) -> Symbol | float:
        return self if _is(other, 1.0) else self.tracer.symbol("/", self, other)

    def __rtruediv__(self, other: float) -> Symbol | float:
        return 0.0 if _is(other, 0.0) else self.tracer.symbol("/", other, self)

    def __neg__(self) -> Symbol | float:
        return self.of[0] if self.kind == "neg" else self.tracer.symbol("neg", self)

    def __pow__(self, power: Symbol | float) -> Any:
        if isinstance(power, int) and power > 0:
            return math.prod([self] * power)
        return _exponential(power * _logarithm(self))

    def __abs__(self) -> Symbol:
        return self.tracer.symbol("abs", self)

    def _given(self, other: object) -> bool:
        """A table's entry that is not structurally 0 counts as there, and as positive where that is asked."""
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
    """An angle of which nothing but sine and cosine can be asked."""

    __slots__ = ("cosine", "sine")

    def __init__(self, sine: Any, cosine: Any) -> None:
        self.sine, self.cosine = sine, cosine


def _is(value: object, number: float) -> bool:
    return isinstance(value, (int, float)) and value == number


def _tracer(*values: object) -> Tracer | None:
    return next((v.tracer for v in values if isinstance(v, Symbol)), None)


def positive(asked: Any, then: Any, otherwise: Any) -> Any:
    """``then`` where ``asked`` is above 0, else ``otherwise``."""
    tracer = asked.tracer if isinstance(asked, Symbol) else None
    if tracer is None:
        return then if asked > 0.0 else otherwise
    return then if then is otherwise else tracer.symbol("positive", asked, then, otherwise)


def _largest(*values: Any) -> Any:
    tracer = _tracer(*values)
    return max(*values) if tracer is None else tracer.symbol("max", *values)


def _smallest(*values: Any) -> Any:
    tracer = _tracer(*values)
    return min(*values) if tracer is None else tracer.symbol("min", *values)


def _root(x: Any) -> Any:
    return x.tracer.symbol("sqrt", x) if isinstance(x, Symbol) else math.sqrt(x)


def _sine_and_cosine(x: Any) -> tuple[Any, Any]:
    """Of an angle up to some thousands of turns: sums, products and choices by sign, error below 2.3e-16."""
    if isinstance(x, Angle):
        return x.sine, x.cosine
    if not isinstance(x, Symbol):
        return math.sin(x), math.cos(x)
    quarter: Any = (x * (2.0 / math.pi) + ROUNDER) - ROUNDER
    rest = ((x - quarter * QUARTER[0]) - quarter * QUARTER[1]) - quarter * QUARTER[2]
    # the quadrant: 0, 1, 2 or 3
    quadrant = quarter - 4.0 * (((quarter * 0.25 - 0.375) + ROUNDER) - ROUNDER)
    square: Any = rest * rest
    sine = rest * square * _horner(SINE, square) + rest
    cosine = square * square * _horner(COSINE, square) + (1.0 - 0.5 * square)
    odd = 0.5 - abs(abs(quadrant - 2.0) - 1.0)
    sine, cosine = positive(odd, cosine, sine), positive(odd, sine, cosine)
    return positive(quadrant - 1.5, -sine, sine), positive(1.0 - abs(quadrant - 1.5), -cosine, cosine)


def _facing(frame: Any, base: Any, turn: Any) -> Angle:
    """As :func:`swimid.swimmer.choice.facing`."""
    _, c, s = frame
    cosine, sine = turn
    return Angle(s * cosine + c * sine, c * cosine - s * sine)


def _exponential(x: Any) -> Any:
    """A power of two times a series for the rest; error below 3e-16 of the value from e^-708 to e^709."""
    if not isinstance(x, Symbol):
        return math.exp(x)
    inside = _largest(_smallest(x, MOST), LEAST)
    rounded = inside * (1.0 / math.log(2.0)) + ROUNDER
    whole: Any = rounded - ROUNDER
    rest = (inside - whole * LOG_2[0]) - whole * LOG_2[1]
    return _horner(EXPONENTIAL, rest) * x.tracer.symbol("two to", rounded)


def _logarithm(x: Any) -> Any:
    """Of a positive number that is not denormal; error below 3e-16 or that share of the value."""
    if not isinstance(x, Symbol):
        return math.log(x)
    power, rest = (x.tracer.symbol(kind, x) for kind in ("exponent", "mantissa"))
    above = rest - math.sqrt(2.0)
    power, rest = positive(above, power + 1.0, power), positive(above, 0.5 * rest, rest)
    ratio = (rest - 1.0) / (rest + 1.0)
    series = 2.0 * ratio * _horner(LOGARITHM, ratio * ratio)
    return power * LOG_2[0] + (series + power * LOG_2[1])


def _horner(coefficients: tuple[float, ...], x: Any) -> Any:
    value: Any = coefficients[0]
    for c in coefficients[1:]:
        value = value * x + c
    return value


#: ``math`` for symbols.
MATH = SimpleNamespace(
    sqrt=_root,
    exp=_exponential,
    log=_logarithm,
    sin=lambda x: _sine_and_cosine(x)[0],
    cos=lambda x: _sine_and_cosine(x)[1],
    pi=math.pi,
    nan=math.nan,
    inf=math.inf,
)


def on_symbols(function: Any) -> Callable[..., Any]:
    """A compiled function, and all it calls, as plain Python that takes symbols."""
    return _plain(function, {})


def _plain(function: Any, known: dict[Any, Any]) -> Any:
    if function in known:
        return known[function]
    # a function of a force is compiled for C
    text = function.py_func if isinstance(function, Dispatcher) else function.__wrapped__
    names: dict[str, Any] = {}
    known[function] = FunctionType(text.__code__, names, text.__name__, text.__defaults__)
    for name, value in text.__globals__.items():
        names[name] = _plain(value, known) if isinstance(value, Dispatcher) else value
    names.update(math=MATH, max=_largest, min=_smallest, positive=positive, facing=_facing)
    return known[function]


def array(tracer: Tracer, kind: str, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """An array of input symbols, numbered from 0."""
    inputs = np.empty(shape, dtype=object)
    inputs.reshape(-1)[:] = [tracer.symbol(kind, i) for i in range(inputs.size)]
    return inputs
