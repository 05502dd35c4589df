"""Compiled lanes of a robot: traced once, kept on disk, run in batches."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.codegen import get_host_cpu_features
from numpy.typing import NDArray

from swimid.swimmer.lanes import source, symbols
from swimid.swimmer.lanes.source import LANES, Traced

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Engine:
    """What tracing asks of an engine.

    Attributes
    ----------
    module : module
        With ``derivative(state, row, *tables, *extra, *scratch, rate)``.
    shapes : callable
        Tables -> length of the state, and the shapes of the scratch arrays.
    extra : tuple
        Arguments of ``derivative`` between the tables and the scratch arrays.
    settled : compiled function or None
        Done to a state after each step.
    """

    module: ModuleType
    shapes: Callable[[Mapping[str, Any]], tuple[int, Sequence[tuple[int, ...]]]]
    extra: tuple[Any, ...] = ()
    settled: Any = None


class Kernel:
    """Up to :data:`LANES` runs of one robot at once.

    Parameters
    ----------
    engine : Engine
    tables : callable
        Coefficients -> the engine's tables by their names.
    coefficients : int
    """

    def __init__(self, engine: Engine, tables: Callable[[Array], dict[str, Any]], coefficients: int) -> None:
        self.engine = engine
        self._example = tables(np.ones(coefficients))
        self.size, self._scratch = engine.shapes(self._example)
        self._fixed = _fixed(tables, coefficients)
        self._taken = {name: np.isnan(fixed) for name, fixed in self._fixed.items()}
        self._traced: Traced | None = None
        self._module: ModuleType | None = None

    def fits(self, tables: Mapping[str, Any]) -> bool:
        """Whether a run's tables have this robot's structure: an effect may have filled in what is nought in it."""
        for name, example in self._example.items():
            given, fixed = tables[name], self._fixed.get(name)
            if fixed is None:
                if not np.array_equal(given, example):
                    return False
            elif np.shape(given) != fixed.shape or not (self._taken[name] | (given == fixed)).all():
                return False
        return True

    def traced(self) -> Traced:
        """The equations as operations."""
        if self._traced is None:
            self._traced = self._trace()
        return self._traced

    def _trace(self) -> Traced:
        tracer = symbols.Tracer()
        arguments, count = [], 0
        for name, example in self._example.items():
            fixed = self._fixed.get(name)
            if fixed is None:
                arguments.append(example)
                continue
            given = np.empty(fixed.shape, dtype=object)
            flat = given.reshape(-1)
            for j, value in enumerate(fixed.reshape(-1)):
                if np.isnan(value):
                    flat[j], count = tracer.symbol("table", count), count + 1
                else:
                    flat[j] = float(value)
            arguments.append(given if given.ndim else given.item())
        driven = int(self._example["topology"][:, 1].max()) + 1
        state = symbols.array(tracer, "state", (self.size,))
        row = symbols.array(tracer, "row", (driven, 5))
        scratch = [np.zeros(shape, dtype=object) for shape in self._scratch]
        for array in scratch:
            array[...] = 0.0
        rate = np.zeros(self.size, dtype=object)
        symbols.on_symbols(self.engine.module.derivative)(
            state, row, *arguments, *self.engine.extra, *scratch, rate
        )
        after = symbols.Tracer()
        settled = symbols.array(after, "state", (self.size,)) if self.engine.settled else np.empty(0, dtype=object)
        if self.engine.settled:
            symbols.on_symbols(self.engine.settled)(settled)
        used = _used(tracer.operations, rate)
        return Traced(used, list(rate), (_used(after.operations, settled), list(settled)), count, 5 * driven)

    def compiled(self) -> ModuleType:
        """The module, written and compiled where this machine does not have it yet."""
        if self._module is None:
            self._module = _imported(source.text(self.traced()))
        return self._module

    def run(
        self, starts: Sequence[Array], steps_s: Sequence[float], drives: Sequence[Array], tables: Sequence[Mapping[str, Any]]
    ) -> list[tuple[Array, Array]]:
        """States and rates of each run, as ``engine.integrate`` gives them.

        Parameters
        ----------
        starts : sequence of ndarray, shape (size,)
        steps_s : sequence of float
        drives : sequence of ndarray, shape (2 steps + 1, driven joints, 5)
        tables : sequence of mappings that :meth:`fits`

        Returns
        -------
        list of (states, rates), each shape (steps + 1, size)
        """
        found: list[tuple[Array, Array]] = []
        # runs of like length side by side
        order = sorted(range(len(starts)), key=lambda k: len(drives[k]))
        places = {}
        for first in range(0, len(order), LANES):
            batch = order[first : first + LANES]
            for k, one in zip(batch, self._batch(batch, starts, steps_s, drives, tables), strict=True):
                places[k] = one
        found = [places[k] for k in range(len(starts))]
        return found

    def _batch(self, batch, starts, steps_s, drives, tables):  # type: ignore[no-untyped-def]
        module, traced = self.compiled(), self.traced()
        lanes = [*batch, *[batch[0]] * (LANES - len(batch))]
        steps = [(len(drives[k]) - 1) // 2 for k in batch]
        start = np.stack([starts[k] for k in lanes], axis=-1)
        parameters = np.stack([self._numbers(tables[k]) for k in lanes], axis=-1)
        states = np.empty((LANES, max(steps) + 1, self.size))
        rates = np.empty_like(states)
        module.integrate(
            start.reshape(-1),
            np.array([steps_s[k] for k in lanes], dtype=float),
            *(np.ascontiguousarray(drives[k]).reshape(len(drives[k]), -1) for k in lanes),
            max(steps),
            parameters.reshape(-1),
            states,
            rates,
            np.empty(source.length(traced)),
        )
        return [(states[j, : n + 1], rates[j, : n + 1]) for j, n in enumerate(steps)]

    def _numbers(self, tables: Mapping[str, Any]) -> Array:
        parts = [np.asarray(tables[name], dtype=float)[taken] for name, taken in self._taken.items()]
        return np.concatenate([p.reshape(-1) for p in parts])


def _fixed(tables: Callable[[Array], dict[str, Any]], coefficients: int) -> dict[str, Array]:
    """Entries that are 0, 1 or -1 whatever the coefficients, NaN for the rest; of the tables of numbers."""
    draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, coefficients))
    samples = [tables(draw) for draw in draws]
    found = {}
    for name, first in samples[0].items():
        values = np.array([s[name] for s in samples], dtype=object if isinstance(first, bool) else None)
        if values.dtype.kind != "f":
            continue
        same = (values == values[0]).all(axis=0) & np.isin(values[0], (0.0, 1.0, -1.0))
        found[name] = np.where(same, values[0], np.nan)
    return found


def _used(operations: Sequence[symbols.Symbol], results: Any) -> list[symbols.Symbol]:
    """The operations that a result needs, in their order."""
    needed, open_ = set(), [x for x in results if isinstance(x, symbols.Symbol)]
    while open_:
        x = open_.pop()
        if x.number not in needed:
            needed.add(x.number)
            open_ += [a for a in x.of if isinstance(a, symbols.Symbol)]
    return [x for x in operations if x.number in needed]


def folder() -> Path:
    """Where generated modules and their compiled forms are kept: beside numba's other caches of swimid."""
    base = numba.config.CACHE_DIR or Path(__file__).parent / "__pycache__"
    return Path(base) / "lanes"


def _imported(text: str) -> ModuleType:
    """A module of this text, named by it, by the compiler and by the processor."""
    host = f"{numba.__version__} {llvmlite.__version__} {get_host_cpu_features()}"
    name = "lanes_" + hashlib.sha256(f"{host}\n{text}".encode()).hexdigest()[:16]
    if name in sys.modules:
        return sys.modules[name]
    place = folder()
    place.mkdir(parents=True, exist_ok=True)
    path = place / f"{name}.py"
    if not path.exists():
        part = path.with_suffix(f".{os.getpid()}")
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
