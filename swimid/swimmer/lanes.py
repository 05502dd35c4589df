"""Compiled kernels of a robot, which integrate a batch of simulations at once. They are stored on disk.

An engine is the compiled equations of motion of a robot. The functions of an engine can also run as Python
functions on symbols instead of numbers. They then run through their loops over links and elements once, and
record a list of sums and products. Operations with input entries that are always 0 or 1 are removed. An
engine that runs on symbols may branch on a value only by :func:`swimid.swimmer.engine.positive`, ``max``,
``min`` and ``abs``.

:func:`source_of` writes the operations as the text of a module, which integrates a batch of simulations by a
fourth-order Runge-Kutta method. The operations are the body of a loop ``for lane in range(LANES)`` over one
flat work array, which the compiler vectorises. The compiler vectorises a loop only if it writes no second
array, all indices are literal, and no statement leaves the loop early. Therefore inputs and results are
copied in other loops.

A :class:`Kernel` is such a module of one robot, with or without the forces and elements of effects.
:class:`Kernels` has both, and chooses one of them for each simulation.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from types import FunctionType, ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import llvmlite  # type: ignore[import-untyped]
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core.codegen import get_host_cpu_features
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.files.kernels import numba
from swimid.fitting.model import ExternalForce, Traceable
from swimid.notices import Progress, silent
from swimid.swimmer.engine import FILLED, MAX_STATE, interpolate_states
from swimid.swimmer.tree import Tree

if TYPE_CHECKING:
    from swimid.swimmer.model import SimulationRequest

Array = NDArray[np.float64]
#: Coefficients of ``(sin(x) - x) / x^3`` and ``(cos(x) - 1 + x^2 / 2) / x^4`` in powers of x^2, for angles x
#: between -45 and 45 degrees (S. Moshier, Cephes: sin.c, double precision). They are shorter than the Taylor
#: series of equal accuracy.
SINE_COEFFICIENTS = (
    1.58962301576546568060e-10,
    -2.50507477628578072866e-8,
    2.75573136213857245213e-6,
    -1.98412698295895385996e-4,
    8.33333333332211858878e-3,
    -1.66666666666666307295e-1,
)
COSINE_COEFFICIENTS = (
    -1.13585365513876817300e-11,
    2.08757008419747316778e-9,
    -2.75573141792967388112e-7,
    2.48015872888517045348e-5,
    -1.38888888888730564116e-3,
    4.16666666666665929218e-2,
)
#: The angle pi / 2, rad, as a sum of three numbers. The numbers have so few digits that products with them
#: are exact (Cody and Waite 1980).
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
        """Return the symbolic variable for the result of an arithmetic operation in the generated code."""
        key = (kind, *(a.number if isinstance(a, Symbol) else (repr(a),) for a in of))
        if key not in self._known:
            self._known[key] = Symbol(self, kind, of, len(self.operations))
            self.operations.append(self._known[key])
        return self._known[key]


class Symbol:
    """Placeholder for a number in traced equations: the result of an operation, or an input with its index.

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
        if isinstance(other, Symbol):
            return self * (1.0 / other)
        if _is(other, 1.0):
            return self
        return self.tracer.symbol("/", self, other)

    def __rtruediv__(self, other: float) -> Symbol | float:
        # compute the reciprocal as a separate operation, because several quotients may have the same divisor
        return other * self.tracer.symbol("/", 1.0, self)

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

    def _is_above(self, other: object) -> bool:
        """Return True for the comparisons ``> 0`` and ``!= 0`` of an entry of an input array.

        A symbol for such an entry stands for a positive value. Other comparisons raise an error.
        """
        if self.kind == "table" and _is(other, 0.0):
            return True
        raise TypeError("the equations ask for a value: write positive(), max() or min()")

    __gt__ = __ne__ = _is_above

    def __le__(self, other: object) -> bool:
        return not self._is_above(other)

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


def choose_positive(asked: Any, then: Any, otherwise: Any) -> Any:
    """Return ``then`` if ``asked`` is above 0, otherwise ``otherwise``, for numbers and for symbols."""
    if then is otherwise:
        return then
    if isinstance(asked, Symbol):
        return asked.tracer.symbol("positive", asked, then, otherwise)
    return then if asked > 0.0 else otherwise


def _trace_call(kind: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls ``function`` for numbers, and records an operation for symbols."""

    def apply(*values: Any) -> Any:
        tracer = next((v.tracer for v in values if isinstance(v, Symbol)), None)
        if tracer is None:
            return function(*values)
        return tracer.symbol(kind, *values)

    return apply


_largest, _smallest, _root = _trace_call("max", max), _trace_call("min", min), _trace_call("sqrt", math.sqrt)


def sine_and_cosine(x: Any) -> tuple[Any, Any]:
    """Return sine and cosine of an angle of up to some thousand rotations, with an error below 2.3e-16."""
    if isinstance(x, Angle):
        return x.sine, x.cosine
    if not isinstance(x, Symbol):
        return math.sin(x), math.cos(x)
    quarter: Any = (x * (2.0 / math.pi) + ROUNDER) - ROUNDER
    rest = ((x - quarter * QUARTER[0]) - quarter * QUARTER[1]) - quarter * QUARTER[2]
    # compute the quadrant of the angle: 0, 1, 2 or 3
    quadrant = quarter - 4.0 * (((quarter * 0.25 - 0.375) + ROUNDER) - ROUNDER)
    square: Any = rest * rest
    sine = rest * square * _horner(SINE_COEFFICIENTS, square) + rest
    cosine = square * square * _horner(COSINE_COEFFICIENTS, square) + (1.0 - 0.5 * square)
    odd = 0.5 - abs(abs(quadrant - 2.0) - 1.0)
    sine, cosine = choose_positive(odd, cosine, sine), choose_positive(odd, sine, cosine)
    near_half = 1.0 - abs(quadrant - 1.5)
    return choose_positive(quadrant - 1.5, -sine, sine), choose_positive(near_half, -cosine, cosine)


def _trace_heading(frame: Any, base: Any, turn: Any) -> Angle:
    """Return the heading of a link in the world by its sine and cosine.

    For symbols, this function replaces :func:`swimid.swimmer.engine.find_heading`.
    """
    _, c, s = frame
    cosine, sine = turn
    return Angle(s * cosine + c * sine, c * cosine - s * sine)


def _exponential(x: Any) -> Any:
    """Return the exponential for results from e^-708 to e^709, with a relative error below 3e-16.

    The result is a power of two multiplied by the Taylor series of the remaining factor.
    """
    if not isinstance(x, Symbol):
        return math.exp(x)
    inside = _largest(_smallest(x, MOST), LEAST)
    rounded = inside * (1.0 / math.log(2.0)) + ROUNDER
    whole: Any = rounded - ROUNDER
    rest = (inside - whole * LOG_2[0]) - whole * LOG_2[1]
    return _horner(EXPONENTIAL, rest) * x.tracer.symbol("two to", rounded)


def _logarithm(x: Any) -> Any:
    """Return the natural logarithm of a positive normal double.

    The absolute or the relative error is below 3e-16.
    """
    if not isinstance(x, Symbol):
        return math.log(x)
    power, rest = (x.tracer.symbol(kind, x) for kind in ("exponent", "mantissa"))
    above = rest - math.sqrt(2.0)
    power, rest = choose_positive(above, power + 1.0, power), choose_positive(above, 0.5 * rest, rest)
    ratio = (rest - 1.0) / (rest + 1.0)
    series = 2.0 * ratio * _horner(LOGARITHM, ratio * ratio)
    return power * LOG_2[0] + (series + power * LOG_2[1])


def _horner(coefficients: tuple[float, ...], x: Any) -> Any:
    """Return the value of a polynomial, whose coefficients begin with that of the highest power."""
    value: Any = coefficients[0]
    for c in coefficients[1:]:
        value = value * x + c
    return value


#: Functions that replace those of the module ``math`` when an engine is called with symbols.
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
    # the function of a force is compiled by cfunc, whose result is not a Dispatcher
    text = function.py_func if isinstance(function, Dispatcher) else function.__wrapped__
    names: dict[str, Any] = {}
    known[function] = FunctionType(text.__code__, names, text.__name__, text.__defaults__)
    for name, value in text.__globals__.items():
        names[name] = _plain(value, known) if isinstance(value, Dispatcher) else value
    names.update(
        math=MATH, max=_largest, min=_smallest, positive=choose_positive, find_heading=_trace_heading
    )
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
    """Equations of motion of an engine as a list of operations, from which :func:`source_of` writes a module.

    Attributes
    ----------
    operations : sequence of Symbol
    rates : sequence of Symbol or float, length of the state
    settled : (sequence of Symbol, mapping of index to Symbol or float)
        Operations on the state after a step, and the entries of the state that they correct.
    parameters : int
        Number of inputs from the input arrays of the engine.
    width : int
        Number of entries in a row of the drive array.
    """

    operations: Sequence[Symbol]
    rates: Sequence[Symbol | float]
    settled: tuple[Sequence[Symbol], Mapping[int, Symbol | float]]
    parameters: int
    width: int


_DOUBLE, _INTEGER = ir.DoubleType(), ir.IntType(64)


def _integer(number: int) -> Any:
    return ir.Constant(_INTEGER, number)


def _on_bits(change: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Return a function that writes machine code by which the bits of a double are changed."""
    return lambda b, x: b.bitcast(change(b, b.bitcast(x, _INTEGER)), _DOUBLE)


def _of_processor(name: str) -> Callable[[Any, Any], Any]:
    """Return a function that writes the machine code of an intrinsic of the processor, such as sqrt."""
    return lambda b, x: b.call(b.module.declare_intrinsic(name, [_DOUBLE]), [x])


def _if_greater(b: Any, x: Any, y: Any, then: Any, otherwise: Any) -> Any:
    return b.select(b.fcmp_ordered(">", x, y), then, otherwise)


#: Functions that write the machine code of an operation, by kind. A double has 52 bits of mantissa below the
#: exponent, which has an offset of 1023. When 1.5 * 2^52 or 2^52 (0x433) is added to a number, the last bits
#: of the sum are the number rounded to an integer.
_EMITTED: dict[str, Callable[..., Any]] = {
    "+": lambda b, x, y: b.fadd(x, y),
    "-": lambda b, x, y: b.fsub(x, y),
    "*": lambda b, x, y: b.fmul(x, y),
    "/": lambda b, x, y: b.fdiv(x, y),
    "positive": lambda b, x, y, z: _if_greater(b, x, ir.Constant(_DOUBLE, 0.0), y, z),
    "max": lambda b, x, y: _if_greater(b, x, y, x, y),
    "min": lambda b, x, y: _if_greater(b, y, x, x, y),
    "neg": lambda b, x: b.fneg(x),
    "abs": _of_processor("llvm.fabs"),
    "sqrt": _of_processor("llvm.sqrt"),
    "two to": _on_bits(lambda b, n: b.shl(b.add(n, _integer(1023)), _integer(52))),
    "mantissa": _on_bits(lambda b, n: b.or_(b.and_(n, _integer(2**52 - 1)), _integer(1023 << 52))),
    "exponent": lambda b, x: b.fsub(
        _on_bits(lambda b, n: b.or_(b.lshr(n, _integer(52)), _integer(0x433 << 52)))(b, x),
        ir.Constant(_DOUBLE, 2.0**52 + 1023.0),
    ),
}


class Program(list[tuple[Any, ...]]):
    """List of operations on the work array, in the form that :func:`emit` takes.

    An operation is its kind, followed by numbers (float) and indices of earlier operations (int). The
    operation ``("load", place)`` reads the entry of a simulation at a place of the work array, ``("store",
    place, value)`` writes it, and ``("given", k)`` is the k-th of two numbers that all simulations share.
    """

    def add(self, *operation: Any) -> int:
        """Append an operation, and return its index."""
        self.append(operation)
        return len(self) - 1

    def copy_symbols(self, operations: Sequence[Symbol], load: Callable[[Symbol], int]) -> dict[int, int]:
        """Append traced operations, and return the index of each by the number of its symbol.

        Parameters
        ----------
        operations : sequence of Symbol
        load : callable
            Function from an input symbol to its place in the work array.
        """
        found: dict[int, int] = {}
        for x in operations:
            if x.kind in _EMITTED:
                of = [found[a.number] if isinstance(a, Symbol) else float(a) for a in x.of]
                found[x.number] = self.add(x.kind, *of)
            else:
                found[x.number] = self.add("load", load(x))
        return found


def emit(program: Sequence[tuple[Any, ...]]) -> Any:
    """Return a function for compiled code that runs a program on the entries of one simulation.

    Its arguments are the work array, the index of the simulation, and the two given numbers. The machine code
    is written here, because the compiler would take several times as long with the program as Python text.
    """

    @intrinsic
    def run(typing: Any, work: Any, lane: Any, first: Any, second: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = context.make_array(work)(context, builder, arguments[0])

            def entry(place: int) -> Any:
                at = builder.add(arguments[1], _integer(place))
                return builder.gep(array.data, [at], inbounds=True)

            found: list[Any] = []

            def value(a: Any) -> Any:
                return found[a] if isinstance(a, int) else ir.Constant(_DOUBLE, a)

            for kind, *of in program:
                if kind == "load":
                    found.append(builder.load(entry(of[0])))
                elif kind == "store":
                    found.append(builder.store(value(of[1]), entry(of[0])))
                elif kind == "given":
                    found.append(arguments[2 + of[0]])
                else:
                    found.append(_EMITTED[kind](builder, *map(value, of)))
            return context.get_dummy_value()

        return types.void(work, types.int64, types.float64, types.float64), generate

    return run


def work_length(traced: Traced) -> int:
    """Return the length of the work array that the module of a traced engine needs."""
    return LANES * (4 * len(traced.rates) + 2 + traced.width + traced.parameters)


def _write_rates(
    traced: Traced, slots: Mapping[str, int], blocks: tuple[int, int, int, int], step: int
) -> Program:
    """Return the program that computes the rates, the state of the next stage, and the sum of the rates.

    Parameters
    ----------
    traced : Traced
    slots : mapping of kind of input to int
        Place in the work array from which the inputs of each kind begin.
    blocks : (int, int, int, int)
        Places of the state before the step, the state after it, the state of the stage, and the rates.
    step : int
        Place of the step.
    """
    here, total, stage, rate = blocks
    rates = Program()
    known = rates.copy_symbols(traced.operations, lambda x: slots[x.kind] + LANES * x.of[0])
    step_s = rates.add("load", step)
    half, share = (rates.add("*", rates.add("given", k), step_s) for k in (0, 1))
    for j, x in enumerate(traced.rates):
        value = known[x.number] if isinstance(x, Symbol) else float(x)
        rates.add("store", rate + LANES * j, value)
        for place, origin, part in ((stage, here, half), (total, total, share)):
            moved = rates.add("+", rates.add("load", origin + LANES * j), rates.add("*", part, value))
            rates.add("store", place + LANES * j, moved)
    return rates


def _write_check(size: int, blocks: tuple[int, int, int]) -> Program:
    """Return the program that sets a simulation to NaN if it has diverged.

    ``blocks`` are the places of the state before the step, of the state after it, and of the rates.
    """
    here, _, rate = blocks
    places = [LANES * j for j in range(size)]
    check = Program()
    far, gone = 0.0, 0.0
    for j in places:
        far = check.add("max", check.add("abs", check.add("load", here + j)), far)
        gone = check.add("+", gone, check.add("load", rate + j))
    gone = check.add("positive", check.add("-", MAX_STATE, far), check.add("*", 0.0, gone), math.nan)
    for place in (first + j for first in blocks for j in places):
        check.add("store", place, check.add("+", check.add("load", place), gone))
    return check


def source_of(traced: Traced) -> str:
    """Return the text of the module that integrates a batch of simulations with a traced engine.

    The function of the module is ``integrate(start, step, table0, ..., shared, steps, parameters, states,
    rates, work)``:

    - ``start``, ``step`` and ``parameters`` are flat. The simulation is the last axis.
    - ``table0`` and so on are drive arrays of shape (2 steps + 1 or fewer, width).
      The last row holds for all later times. If ``shared`` is true, all simulations read the first array.
    - ``states`` and ``rates`` have shape (simulations, steps + 1, size). They are NaN after a breakdown.
    """
    size = len(traced.rates)
    here, total, stage, rate = (LANES * size * k for k in range(4))
    step = 4 * LANES * size
    row = step + LANES
    parameter = row + LANES * traced.width
    elapsed = parameter + LANES * traced.parameters
    slots = {"state": stage, "row": row, "table": parameter, "number": parameter, "elapsed": elapsed}
    rates = _write_rates(traced, slots, (here, total, stage, rate), step)
    check = _write_check(size, (here, total, rate))
    settle = Program()
    known = settle.copy_symbols(traced.settled[0], lambda x: total + LANES * x.of[0])
    for k, x in traced.settled[1].items():
        settle.add("store", total + LANES * k, known[x.number] if isinstance(x, Symbol) else float(x))
    drives = ", ".join(["f8[:, ::1]"] * LANES)
    tables = ", ".join(f"table{lane}" for lane in range(LANES))
    # copy the row of each simulation by literal indices
    copies = ""
    for lane in range(LANES):
        copies += f"""
                last = min(n, table{lane}.shape[0] - 1)
                for q in range({traced.width}):
                    w[{row + lane} + {LANES} * q] = table{lane}[last, q]"""
    return f""""Generated by swimid: {LANES} runs of one robot. Writer of machine code: {_writer()}"

import numba

from swimid.swimmer.lanes import emit

SIGNATURE = "void(f8[::1], f8[::1], {drives}, b1, i8, f8[::1], f8[:, :, ::1], f8[:, :, ::1], f8[::1])"
derivative = emit({_format_program(rates)})
check = emit({_format_program(check)})
settle = emit({_format_program(settle)})


@numba.njit(nogil=True, error_model="numpy", fastmath={{"contract", "nsz"}}, boundscheck=False, cache=True)
def integrate(start, step, {tables}, shared, steps, parameters, states, rates, w):
    count = states.shape[0]
    for q in range({LANES * traced.parameters}):
        w[{parameter} + q] = parameters[q]
    for q in range({LANES * size}):
        w[{here} + q] = start[q]
        w[{total} + q] = start[q]
        w[{stage} + q] = start[q]
    for lane in range({LANES}):
        w[{step} + lane] = step[lane]
    for evaluation in range(4 * steps + 1):
        part = evaluation & 3
        whole = evaluation >> 2
        half = 1.0 if part == 2 else 0.5
        share = 1.0 / 3.0 if part == 1 or part == 2 else 1.0 / 6.0
        if part == 1 or part == 3 or evaluation == 0:
            n = (evaluation + 1) >> 1
            if shared:
                last = min(n, table0.shape[0] - 1)
                for q in range({traced.width}):
                    for lane in range({LANES}):
                        w[{row} + {LANES} * q + lane] = table0[last, q]
            else:{copies}
            for lane in range({LANES}):
                w[{elapsed} + lane] = 0.5 * n * w[{step} + lane]
        for lane in range({LANES}):
            derivative(w, lane, half, share)
        if part == 0:
            for lane in range({LANES}):
                check(w, lane, 0.0, 0.0)
            for lane in range(count):
                for q in range({size}):
                    states[lane, whole, q] = w[{here} + {LANES} * q + lane]
                    rates[lane, whole, q] = w[{rate} + {LANES} * q + lane]
        if part == 3:
            for lane in range({LANES}):
                settle(w, lane, 0.0, 0.0)
            for q in range({LANES * size}):
                w[{here} + q] = w[{total} + q]
                w[{stage} + q] = w[{total} + q]
"""


@cache
def _writer() -> str:
    """Return a hash of this module, which identifies the functions that write machine code."""
    return hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:16]


def _format_program(program: Program) -> str:
    """Return a program as Python text, with one operation on each line."""
    lines = ",\n    ".join(map(repr, program)).replace("nan", 'float("nan")')
    return f"[\n    {lines}\n]"


# ---------------------------------------------------------------- kernels

#: Maximum number of result arrays that are reused by later batches.
N_BUFFERS = 8


@dataclass(frozen=True)
class Room:
    """Elements, changes of input arrays, and forces that effects may add to a robot.

    Attributes
    ----------
    rows : mapping of table to links
        Links of additional elements, in the order in which effects append them. The links of table ``t``
        are in table ``t_link``.
    filled : mapping of table to index
        Entries that effects change.
    forces : sequence of (Traceable, link)
        Forces. Each may act at most once in a simulation.
    """

    rows: Mapping[str, Sequence[int]]
    filled: Mapping[str, Any]
    forces: Sequence[tuple[Traceable, int]]


#: Name of the input array with the external forces in a simulation. Its entries are the start time (s), the
#: coordinate frame (:func:`swimid.swimmer.engine.place_frame`), and for each force: 1 or 0 (whether the force
#: acts), its point and its constants.
ACTING = "acting"
#: Elements whose input array of integers has the row of their input in its second column.
STEERED = ("propeller", "rudder", "slider")
#: Number of entries for the coordinate frame in the input array :data:`ACTING`.
FRAME_LENGTH = 8


class Kernel:
    """Compiled equations of motion of one robot, which integrate up to :data:`LANES` simulations at once.

    If the kernel has a :class:`Room` for effects, each simulation has its own effects or none. One kernel
    serves all effects, because compiling takes seconds. Each simulation therefore also computes the forces of
    effects that it does not have. This costs little compared with a simulation by the scalar engine.

    Parameters
    ----------
    tree : Tree
        Links of the robot, with their engine and its input arrays.
    room : Room, optional
        Elements, entries and forces of the effects.
    """

    def __init__(self, tree: Tree, room: Room | None = None) -> None:
        self.engine, self.room = tree.engine, room
        tables: Callable[[Array], dict[str, Any]] = tree.tables
        if room is not None:
            tables = self._roomy(room, tables)
        self._example = tables(np.ones(len(tree.names)))
        self.size, self._scratch = self.engine.shapes(self._example)
        self.fixed = _find_constants(tables, len(tree.names))
        for name, columns in FILLED.items():
            self.fixed[name][:, columns] = np.nan
        entries = self._entries(self.fixed)
        self._taken, self._known = np.flatnonzero(np.isnan(entries)), np.flatnonzero(~np.isnan(entries))
        self._structure, self._links = entries[self._known], self._integers(self._example)
        self._shapes = [np.shape(table) for table in self._example.values()]
        self._lock = threading.RLock()
        self._buffers: list[Array] = []
        self.module: ModuleType | None = None

    def _roomy(
        self, room: Room, tables: Callable[[Array], dict[str, Any]]
    ) -> Callable[[Array], dict[str, Any]]:
        """Return a function that computes input arrays with NaN in the entries that effects may change."""
        self._slots: dict[tuple[int, int], slice] = {}
        at = 1 + FRAME_LENGTH
        for known, link in room.forces:
            self._slots[id(known.function), link] = slice(at, at + 3 + known.constants)
            at += 3 + known.constants
        # the constants of a force that does not act are ones, because the force may divide by them
        self._idle = np.ones(at)
        self._idle[[place.start for place in self._slots.values()]] = 0.0

        def open_tables(values: Array) -> dict[str, Any]:
            found = dict(tables(values))
            for name, links in room.rows.items():
                added = np.full((len(links), found[name].shape[1]), np.nan)
                found[f"{name}_link"] = np.append(found[f"{name}_link"], np.array(links, dtype=np.int64))
                found[name] = np.vstack([found[name], added])
            for name, places in room.filled.items():
                found[name] = found[name].copy()
                found[name][places] = np.nan
            return {**found, ACTING: np.full(at, np.nan)}

        return open_tables

    def fits(self, tables: Mapping[str, Any]) -> bool:
        """Return whether ``tables`` has the constant entries of this robot, so that the kernel applies.

        The result is False if an effect has changed an entry that is constant in the kernel.
        """
        if [np.shape(tables[name]) for name in self._example] != self._shapes:
            return False
        alike = (self._integers(tables) == self._links).all()
        return bool(alike and (self._entries(tables)[self._known] == self._structure).all())

    @cached_property
    def equations(self) -> Traced:
        """Equations of motion of the robot as operations on symbols."""
        tracer = Tracer()
        tables = dict(self._example)
        count = 0
        for name, fixed in self.fixed.items():
            # entries for forces are symbols of a separate kind, because even their signs are unknown
            kind = {ACTING: "number"}.get(name, "table")
            entries = np.array(fixed, dtype=object)
            for place in np.argwhere(np.isnan(fixed)):
                entries[tuple(place)], count = tracer.symbol(kind, count), count + 1
            tables[name] = entries if entries.ndim else entries.item()
        inputs = [self._example["load_input"], *(self._example[f"{n}_link"][:, 1] for n in STEERED)]
        driven = int(max(self._example["topology"][:, 1].max(), np.concatenate(inputs).max(initial=-1))) + 1
        state = array(tracer, "state", (self.size,))
        row = array(tracer, "row", (driven, 5))
        scratch = [np.full(shape, 0.0, dtype=object) for shape in self._scratch]
        rate = np.zeros(self.size, dtype=object)
        forced, time = None, 0.0
        if self.room is not None:
            acting = tables.pop(ACTING)
            forced, time = self._trace_forces(self.room, acting), acting[0] + tracer.symbol("elapsed", 0)
        compute_rate = on_symbols(self.engine.compute_rate)
        compute_rate(state, row, tuple(tables.values()), forced, time, *scratch, rate)
        after = Tracer()
        settled = array(after, "state", (self.size,))
        on_symbols(self.engine.correct_state)(settled)
        corrected = {j: x for j, x in enumerate(settled) if x.kind != "state"}
        ends = _select_operations(after.operations, corrected.values())
        return Traced(
            _select_operations(tracer.operations, rate), list(rate), (ends, corrected), count, 5 * driven
        )

    def _trace_forces(self, room: Room, acting: Any) -> tuple[Any, ...]:
        """Return the forces of effects as symbols, in the form of the engine's argument ``forced``.

        A force that does not act in a simulation is zero.
        """
        slots = [acting[place] for place in self._slots.values()]
        constants = [np.append(slot[:1], slot[3:]) for slot in slots]

        def call(plain: Any, time: Any, pose: Any, velocity: Any, own: Any, wrench: Any) -> None:
            plain(time, pose, velocity, own[1:], wrench)
            wrench[:] = [choose_positive(own[0], part, 0.0) for part in wrench]

        return (
            [link for _, link in room.forces],
            np.array([slot[1:3] for slot in slots], dtype=object).reshape(-1, 2),
            np.concatenate([np.empty(0, dtype=object), *constants]),
            np.concatenate(([0], np.cumsum([len(own) for own in constants]))).astype(int),
            acting[1 : 1 + FRAME_LENGTH],
            *(np.zeros(3, dtype=object) for _ in range(3)),
            [partial(call, on_symbols(known.function)) for known, _ in room.forces],
        )

    def add_effects(
        self, tables: Mapping[str, Any], forces: Sequence[ExternalForce], frame: Array, begin_s: float
    ) -> dict[str, Any] | None:
        """Return the input arrays of a simulation with the rows and entries for effects that this kernel has.

        Return None if the kernel has no rows or entries for the effects of the simulation.

        Parameters
        ----------
        tables : mapping
            Input arrays of the equations of motion.
        forces : sequence of ExternalForce
        frame : ndarray, shape (8,)
            Coordinate frame of the simulation in the world (:func:`swimid.swimmer.engine.place_frame`).
        begin_s : float
            Time of the initial state.
        """
        assert self.room is not None
        found = dict(tables)
        for name in self.room.rows:
            links = self._example[f"{name}_link"]
            rows = _in_places(tables[name], tables[f"{name}_link"], links)
            if rows is None:
                return None
            found[name], found[f"{name}_link"] = rows, links
        acting = self._idle.copy()
        acting[0], acting[1 : 1 + FRAME_LENGTH] = begin_s, frame
        count = len(found["topology"])
        for force in forces:
            place = self._slots.get((id(force.function), force.link % count))
            if place is None or acting[place.start] != 0.0:
                return None
            acting[place] = 1.0, force.x, force.y, *force.constants
        found[ACTING] = acting
        return found if self.fits(found) else None

    def compile_module(self, progress: Progress = silent, name: str = "") -> ModuleType:
        """Return the compiled module of the kernel. Compile it if this machine does not have it yet.

        Parameters
        ----------
        progress : Progress
        name : str
            Name of the robot for the progress display.
        """
        with self._lock:
            if self.module is None:
                text = source_of(self.equations)
                shown = silent if on_disk(text) else progress
                with shown(f"compiling the equations of {name} (on first use only)"):
                    self.module = load_module(text)
                    self.module.integrate.compile(self.module.SIGNATURE)
            return self.module

    def run(
        self, runs: Sequence[tuple[Array, float, Array, Mapping[str, Any]]]
    ) -> Iterator[tuple[int, tuple[Array, Array]]]:
        """Integrate simulations, and yield the index, the states and the rates of each.

        Parameters
        ----------
        runs : sequence of (start, step, drive, tables)
            Initial state, step (s), motion of the driven joints, shape (2 steps + 1, driven joints, 5), and
            input arrays of each simulation, for which :meth:`fits` must be true.

        Yields
        ------
        index, (states, rates)
            States and rates, shape (steps + 1, size), as ``engine.integrate`` returns them. They are parts of
            the results of a batch, whose memory is reused when no part of them is referred to any more.
        """
        module, traced = self.compile_module(), self.equations
        # put simulations of similar length into the same batch
        order = sorted(range(len(runs)), key=lambda k: len(runs[k][2]))
        for first in range(0, len(order), LANES):
            batch = order[first : first + LANES]
            full = [runs[k] for k in [*batch, *[batch[0]] * (LANES - len(batch))]]
            starts, steps_s, drives, tables = zip(*full, strict=True)
            steps = [(len(drive) - 1) // 2 for drive in drives]
            # simulations at the same coefficients have the same input arrays
            numbers = {id(t): self.numbers(t) for t in {id(t): t for t in tables}.values()}
            states, rates = self._buffer((2, len(batch), max(steps) + 1, self.size))
            module.integrate(
                np.stack(starts, axis=-1).reshape(-1),
                np.array(steps_s, dtype=float),
                *(drive.reshape(len(drive), -1) for drive in drives),
                all(drive is drives[0] for drive in drives),
                max(steps),
                np.stack([numbers[id(t)] for t in tables], axis=-1).reshape(-1),
                states,
                rates,
                np.empty(work_length(traced)),
            )
            for j, k in enumerate(batch):
                yield k, (states[j, : steps[j] + 1], rates[j, : steps[j] + 1])

    def _buffer(self, shape: tuple[int, ...]) -> Array:
        """Return an uninitialised array in memory that no result uses any more.

        With newly allocated memory, a batch of simulations would take one and a half times as long because of
        page faults.
        """
        need = math.prod(shape)
        with self._lock:
            counts, sizes = _references(self._buffers), map(len, self._buffers)
            # leave much longer arrays alone, because a cached part of a result keeps its whole array
            idle = [k for k, n in enumerate(sizes) if need <= n <= 2 * need and counts[k] == IDLE]
            if not idle:
                self._buffers = [np.empty(need), *self._buffers[: N_BUFFERS - 1]]
                idle = [0]
            return self._buffers[idle[0]][:need].reshape(shape)

    def numbers(self, tables: Mapping[str, Any]) -> Array:
        """Return the entries of ``tables`` that are inputs of the kernel, shape (parameters,)."""
        return self._entries(tables)[self._taken]

    def _entries(self, tables: Mapping[str, Any]) -> Array:
        """Return all real entries of the input arrays of the engine in one array, in a fixed order."""
        return np.concatenate([tables[name] for name in self.fixed], axis=None)

    def _integers(self, tables: Mapping[str, Any]) -> NDArray[np.int64]:
        """Return all integer entries of the input arrays, such as links, in one array, in a fixed order."""
        others = [tables[name] for name in self._example if name not in self.fixed]
        return np.concatenate(others, axis=None)


def _references(arrays: Sequence[Array]) -> list[int]:
    """Return the number of Python references to each array."""
    return [sys.getrefcount(array) for array in arrays]


#: Reference count of an array that only a list refers to, so that its memory can be reused.
IDLE = _references([np.empty(0)])[0]


def _find_constants(tables: Callable[[Array], dict[str, Any]], coefficients: int) -> dict[str, Array]:
    """Return the input arrays of an engine with the entries that are 0, 1 or -1 for all coefficients.

    All other entries are NaN.
    """
    draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, coefficients))
    samples = [tables(draw) for draw in draws]
    fixed = {}
    for name in samples[0]:
        values = np.array([s[name] for s in samples])
        if values.dtype.kind != "f":
            continue
        same = (values == values[0]).all(axis=0) & np.isin(values[0], (0.0, 1.0, -1.0))
        fixed[name] = np.where(same, values[0], np.nan)
    return fixed


def _select_operations(operations: Sequence[Symbol], results: Any) -> list[Symbol]:
    """Return those operations on which the results depend, in the same order."""
    needed = {x.number for x in results if isinstance(x, Symbol)}
    for x in reversed(operations):
        if x.number in needed:
            needed.update(a.number for a in x.of if isinstance(a, Symbol))
    return [x for x in operations if x.number in needed]


def folder() -> Path:
    """Return the folder of generated modules, which lies in numba's cache folder of the scalar engine."""
    return Path(interpolate_states.stats.cache_path) / "lanes"


def _path(text: str) -> Path:
    """Return the path of a generated module. Its name is a hash of text, compiler and processor."""
    host = f"{sys.version} {numba.__version__} {llvmlite.__version__} {get_host_cpu_features()}"
    return folder() / f"lanes_{hashlib.sha256(f'{host} {text}'.encode()).hexdigest()[:16]}.py"


def on_disk(text: str) -> bool:
    """Return whether the generated module with this text is compiled on this machine."""
    module = load_module(text)
    return any(Path(module.integrate.stats.cache_path).glob(f"{module.__name__}.integrate-*.nbc"))


def load_module(text: str) -> ModuleType:
    """Return the generated module with this text, and write its file if there is none.

    The module is compiled at its first call.
    """
    path = _path(text)
    if path.stem not in sys.modules:
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic.write_text(path, text)
        module = ModuleType(path.stem)
        module.__file__ = str(path)
        exec(compile(text, path, "exec"), vars(module))
        sys.modules[path.stem] = module
    return sys.modules[path.stem]


def _in_places(rows: Array, links: NDArray[np.int64], places: NDArray[np.int64]) -> Array | None:
    """Return the rows of elements in the order of ``places``, which states the link of each returned row.

    Each element takes the next free row of its link. Rows without an element are zero. The result is None if
    a link has too few rows.
    """
    if np.array_equal(links, places):
        return rows
    found, at = np.zeros((len(places), rows.shape[1])), 0
    for link, row in zip(links, rows, strict=True):
        while at < len(places) and places[at] != link:
            at += 1
        if at == len(places):
            return None
        found[at] = row
        at += 1
    return found


class Kernels:
    """Kernels of one robot: one for simulations without effects, and one for simulations with effects.

    The kernels compute every simulation, a single one or many, so that equal inputs always give equal digits.
    The scalar engine computes only unusual combinations of effects, for which no kernel exists. It computes
    everything if the environment variable ``SWIMID_LANES`` is ``never``. Results of kernels and of the scalar
    engine agree to about fourteen digits.

    Parameters
    ----------
    tree : Tree
        Links of the robot.
    room : callable
        Function that returns the :class:`Room` for effects, or None if there are none. The modules of all
        effects must have been imported when an effect first acts.

    Attributes
    ----------
    used : bool
        Whether the kernels compute simulations.
    """

    def __init__(self, tree: Tree, room: Callable[[], Room | None]) -> None:
        self._tree, self._room = tree, room
        self.used = os.environ.get("SWIMID_LANES") != "never"

    @cached_property
    def own(self) -> Kernel:
        """Kernel for simulations without effects."""
        return Kernel(self._tree)

    @cached_property
    def wide(self) -> Kernel | None:
        """Kernel for simulations with effects; None if no effect can act."""
        room = self._room()
        return None if room is None else Kernel(self._tree, room)

    def prepare(self, name: str, progress: Progress = silent, *, effects: bool = False) -> None:
        """Compile the kernel of the robot with the given name, and with ``effects`` also :attr:`wide`."""
        if not self.used:
            return
        self.own.compile_module(progress, name)
        if effects and self.wide is not None:
            self.wide.compile_module(progress, f"{name} with effects")

    def choose(
        self, run: SimulationRequest, frame: Callable[[SimulationRequest], Array]
    ) -> tuple[Kernel, Mapping[str, Any]] | None:
        """Return the kernel for a simulation with its input arrays; None if the scalar engine is needed.

        Parameters
        ----------
        run : Run
        frame : callable
            Function from a simulation to its coordinate frame in the world, shape (8,).
        """
        if not self.used:
            return None
        if not run.hooks.force and (not run.hooks.tables or self.own.fits(run.tables)):
            return self.own, run.tables
        if self.wide is None:
            return None
        tables = self.wide.add_effects(run.tables, run.hooks.force, frame(run), run.grid.begin_s)
        return None if tables is None else (self.wide, tables)

    def run(
        self, runs: Mapping[Any, SimulationRequest], frame: Callable[[SimulationRequest], Array]
    ) -> Iterator[tuple[Any, tuple[Array, Array]]]:
        """Yield key, states and rates of the simulations that the kernels can compute.

        The results are those of :meth:`Kernel.run`.
        """
        taken: dict[Kernel, dict[Any, tuple[Array, float, Array, Mapping[str, Any]]]] = {}
        for key, run in runs.items():
            choice = self.choose(run, frame)
            if choice is not None:
                kernel, tables = choice
                own = taken.setdefault(kernel, {})
                own[key] = run.start, run.grid.step_s, run.drive.table, tables
        for kernel, own in taken.items():
            keys = list(own)
            for k, result in kernel.run(list(own.values())):
                yield keys[k], result
