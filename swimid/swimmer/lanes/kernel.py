"""Compiled lanes of a robot: traced once, kept on disk, run in batches.

:class:`WideKernel` has room for what effects bring.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import llvmlite  # type: ignore[import-untyped]
import numba
import numpy as np
from numba.core.codegen import get_host_cpu_features
from numba.misc.appdirs import user_cache_dir
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.fitting.hooks import Force, Traceable
from swimid.progress import Progress, silent
from swimid.swimmer.lanes import tracing
from swimid.swimmer.lanes.tracing import LANES, Traced

Array = NDArray[np.float64]

#: What one traced operation takes in the scalar engine, and to compile, s: of the built-in robots, printed
#: by ``python -m benchmarks.bench_lanes --only engine compile``.
OPERATION_S, COMPILING_S = 3.5e-10, 5e-3


@dataclass(frozen=True)
class Engine:
    """What a model and its kernel ask of an engine.

    Attributes
    ----------
    derivative : compiled function
        ``derivative(state, row, *tables, *extra, *scratch, rate)``.
    shapes : callable
        Tables -> length of the state, and the shapes of the scratch arrays.
    extra : tuple
        Arguments of ``derivative`` between the tables and the scratch arrays.
    settled : compiled function or None
        Done to a state after each step.
    filled : mapping of table to columns
        Entries that stay numbers of a run also where the robot has a zero there: effects fill them.
    energetics : compiled function or None
        Inverse dynamics of a finished run: joint torques and powers.
    """

    derivative: Any
    shapes: Callable[[Mapping[str, Any]], tuple[int, Sequence[tuple[int, ...]]]]
    extra: tuple[Any, ...] = ()
    settled: Any = None
    filled: Mapping[str, slice] = field(default_factory=dict)
    energetics: Any = None


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
        for name, columns in engine.filled.items():
            self._fixed[name][:, columns] = np.nan
        entries = self._entries(self._fixed)
        self._taken, self._known = np.flatnonzero(np.isnan(entries)), np.flatnonzero(~np.isnan(entries))
        self._structure = entries[self._known]
        self._lock = threading.RLock()
        self._rooms: list[Array] = []
        self._traced: Traced | None = None
        self._module: ModuleType | None = None

    def fits(self, tables: Mapping[str, Any]) -> bool:
        """Whether a run's tables have this robot's structure: an effect may have filled in a zero."""
        for name, example in self._example.items():
            given = tables[name]
            if name in self._fixed:
                if np.shape(given) != np.shape(example):
                    return False
            elif given is not example and not np.array_equal(given, example):
                return False
        return bool((self._entries(tables)[self._known] == self._structure).all())

    def traced(self) -> Traced:
        """The equations as operations."""
        if self._traced is None:
            self._traced = self._trace()
        return self._traced

    def _trace(self) -> Traced:
        tracer = tracing.Tracer()
        arguments: dict[str, Any] = {}
        count = 0
        for name, example in self._example.items():
            fixed = self._fixed.get(name)
            if fixed is None:
                arguments[name] = example
                continue
            entries = np.empty(fixed.shape, dtype=object)
            flat = entries.reshape(-1)
            for j, value in enumerate(fixed.reshape(-1)):
                if np.isnan(value):
                    flat[j], count = tracer.symbol(self.kind(name), count), count + 1
                else:
                    flat[j] = float(value)
            arguments[name] = entries if entries.ndim else entries.item()
        driven = int(self._example["topology"][:, 1].max()) + 1
        state = tracing.array(tracer, "state", (self.size,))
        row = tracing.array(tracer, "row", (driven, 5))
        scratch = [np.full(shape, 0.0, dtype=object) for shape in self._scratch]
        rate = np.zeros(self.size, dtype=object)
        given = self._arguments(tracer, arguments)
        tracing.on_symbols(self.engine.derivative)(state, row, *given, *scratch, rate)
        after = tracing.Tracer()
        settled = tracing.array(after, "state", (self.size if self.engine.settled else 0,))
        if self.engine.settled:
            tracing.on_symbols(self.engine.settled)(settled)
        used = _used(tracer.operations, rate)
        return Traced(used, list(rate), (_used(after.operations, settled), list(settled)), count, 5 * driven)

    def kind(self, table: str) -> str:
        """What the entries of a table are as inputs (:class:`swimid.swimmer.lanes.tracing.Symbol`)."""
        return "table"

    def _arguments(self, tracer: tracing.Tracer, tables: dict[str, Any]) -> list[Any]:
        """Of the derivative: tables and what follows them."""
        return [*tables.values(), *self.engine.extra]

    def worth(self, derivatives: float, progress: Progress = silent) -> bool:
        """Whether to run side by side, when the equations are about to be evaluated so many times.

        Where the kernel is on this machine, yes. Where it would take longer to compile than what it saves,
        no; then a process of its own compiles it for the next time. The environment variable
        ``SWIMID_LANES`` says ``always`` or ``never`` instead: the two forms agree to some fourteen digits,
        not to the last.
        """
        wanted = os.environ.get("SWIMID_LANES", "auto")
        if wanted == "never":
            return False
        operations = len(self.traced().operations)
        scalar_s = derivatives * OPERATION_S * operations
        if wanted == "auto" and scalar_s < 0.5:
            return False
        text = tracing.text(self.traced())
        if on_disk(text):
            self.compiled()
            return True
        # the work ahead is known to half
        if wanted == "auto" and scalar_s < 2.0 * COMPILING_S * operations:
            later(text)
            return False
        with progress("compiling the simulation for several runs at once (on first use only)"):
            self.compiled()
        return True

    def compiled(self) -> ModuleType:
        """The module, compiled where this machine does not have it yet."""
        with self._lock:
            if self._module is None:
                self._module = _compiled(imported(tracing.text(self.traced())))
            return self._module

    def run(
        self,
        starts: Sequence[Array],
        steps_s: Sequence[float],
        drives: Sequence[Array],
        tables: Sequence[Mapping[str, Any]],
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
        # runs of like length side by side
        order = sorted(range(len(starts)), key=lambda k: len(drives[k]))
        places: dict[int, tuple[Array, Array]] = {}
        for first in range(0, len(order), LANES):
            batch = order[first : first + LANES]
            for k, one in zip(batch, self._batch(batch, starts, steps_s, drives, tables), strict=True):
                places[k] = one
        return [places[k] for k in range(len(starts))]

    def _batch(
        self,
        batch: Sequence[int],
        starts: Sequence[Array],
        steps_s: Sequence[float],
        drives: Sequence[Array],
        tables: Sequence[Mapping[str, Any]],
    ) -> list[tuple[Array, Array]]:
        module, traced = self.compiled(), self.traced()
        lanes = [*batch, *[batch[0]] * (LANES - len(batch))]
        steps = [(len(drives[k]) - 1) // 2 for k in batch]
        start = np.stack([starts[k] for k in lanes], axis=-1)
        parameters = np.stack([self.numbers(tables[k]) for k in lanes], axis=-1)
        states, rates = self._room((2, len(batch), max(steps) + 1, self.size))
        module.integrate(
            start.reshape(-1),
            np.array([steps_s[k] for k in lanes], dtype=float),
            *(np.ascontiguousarray(drives[k]).reshape(len(drives[k]), -1) for k in lanes),
            all(drives[k] is drives[batch[0]] for k in batch),
            max(steps),
            parameters.reshape(-1),
            states,
            rates,
            np.empty(tracing.length(traced)),
        )
        return [(states[j, : n + 1], rates[j, : n + 1]) for j, n in enumerate(steps)]

    def _room(self, shape: tuple[int, ...]) -> Array:
        """An array to write into, of memory no result of an earlier batch lives in any more.

        Fresh memory costs half as much again as the run: every page of it is a fault.
        """
        need = math.prod(shape)
        with self._lock:
            counts = _references(self._rooms)
            idle = [k for k, n in enumerate(counts) if n == IDLE and len(self._rooms[k]) >= need]
            if not idle:
                self._rooms = [np.empty(need), *self._rooms[:7]]
            return self._rooms[idle[0] if idle else 0][:need].reshape(shape)

    def numbers(self, tables: Mapping[str, Any]) -> Array:
        """What of a run's tables the kernel takes as numbers, shape (parameters,)."""
        return self._entries(tables)[self._taken]

    def _entries(self, tables: Mapping[str, Any]) -> Array:
        """All numbers of the tables, one after another."""
        return np.concatenate([np.reshape(tables[name], -1) for name in self._fixed])


def _references(arrays: Sequence[Array]) -> list[int]:
    return [sys.getrefcount(array) for array in arrays]


#: References to an array that nothing but its list holds.
IDLE = _references([np.empty(0)])[0]


def _fixed(tables: Callable[[Array], dict[str, Any]], coefficients: int) -> dict[str, Array]:
    """Entries that are 0, 1 or -1 whatever the coefficients, NaN for the rest; of the tables of numbers."""
    draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, coefficients))
    samples = [tables(draw) for draw in draws]
    fixed = {}
    for name, first in samples[0].items():
        values = np.array([s[name] for s in samples], dtype=object if isinstance(first, bool) else None)
        if values.dtype.kind != "f":
            continue
        same = (values == values[0]).all(axis=0) & np.isin(values[0], (0.0, 1.0, -1.0))
        fixed[name] = np.where(same, values[0], np.nan)
    return fixed


def _used(operations: Sequence[tracing.Symbol], results: Any) -> list[tracing.Symbol]:
    """The operations that a result needs, in their order."""
    needed, open_ = set(), [x for x in results if isinstance(x, tracing.Symbol)]
    while open_:
        x = open_.pop()
        if x.number not in needed:
            needed.add(x.number)
            open_ += [a for a in x.of if isinstance(a, tracing.Symbol)]
    return [x for x in operations if x.number in needed]


def folder() -> Path:
    """Where generated modules and their compiled forms are kept: with numba's other caches."""
    beside = Path(__file__).parent / "__pycache__"
    if numba.config.CACHE_DIR:
        base = Path(numba.config.CACHE_DIR)
    elif os.access(beside if beside.exists() else beside.parent, os.W_OK):
        base = beside
    else:
        base = Path(user_cache_dir("swimid"))
    return base / "lanes"


def _path(text: str) -> Path:
    """Of the module of this text, named by it, by the compiler and by the processor."""
    host = f"{sys.version} {numba.__version__} {llvmlite.__version__} {get_host_cpu_features()}"
    return folder() / f"lanes_{hashlib.sha256(f'{host} {text}'.encode()).hexdigest()[:16]}.py"


def on_disk(text: str) -> bool:
    """Whether the module of this text is compiled on this machine."""
    path = _path(text)
    base = Path(numba.config.CACHE_DIR) if numba.config.CACHE_DIR else path.parent / "__pycache__"
    return any(base.rglob(f"{path.stem}.integrate-*.nbc"))


def imported(text: str) -> ModuleType:
    """The module of this text, written where it is not there yet; it compiles at its first call."""
    path = _path(text)
    if path.stem in sys.modules:
        return sys.modules[path.stem]
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic.write_text(path, text)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def _compiled(module: ModuleType) -> ModuleType:
    """The module, compiled or loaded as it was compiled before."""
    module.integrate.compile(module.SIGNATURE)
    return module


def later(text: str) -> None:
    """Compile a module in a process of its own, which outlives this one; for the next command."""
    imported(text)
    command = "import sys; from swimid.swimmer.lanes import kernel; kernel.compile_file(sys.argv[1])"
    with contextlib.suppress(OSError):  # without it the next command is as fast as this one
        subprocess.Popen(
            [sys.executable, "-c", command, str(_path(text))],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )


def compile_file(path: str) -> None:
    """Compile the module at a path, politely; once, however many ask for it."""
    mark = Path(path).with_suffix(".compiling")
    if mark.exists() and time.time() - mark.stat().st_mtime > 600.0:
        mark.unlink(missing_ok=True)  # of a process that was stopped
    try:
        mark.touch(exist_ok=False)
    except FileExistsError:
        return
    try:
        if hasattr(os, "nice"):
            os.nice(10)
        _compiled(imported(Path(path).read_text(encoding="utf-8")))
    finally:
        mark.unlink(missing_ok=True)


#: The table of what a run brings beside the robot's: begin (s), place (:func:`placed` of the engine), and of
#: each force whether it acts, its point and its constants.
ACTING = "acting"
FRAME = 7


@dataclass(frozen=True)
class Room:
    """What effects may bring to a robot.

    Attributes
    ----------
    rows : mapping of table to links
        Elements beyond the robot's own, in the order in which effects append them; the links of table ``t``
        are table ``t_link``.
    filled : mapping of table to index
        Entries that effects change, whatever the robot has there.
    forces : sequence of (Traceable, link)
        Each at most once.
    """

    rows: Mapping[str, Sequence[int]]
    filled: Mapping[str, Any]
    forces: Sequence[tuple[Traceable, int]]


class WideKernel(Kernel):
    """Up to :data:`LANES` runs of one robot at once, each with its own effects or none.

    One for all effects, since compiling takes seconds; what a run pays for the forces of others is little
    beside what it would take alone.

    Parameters
    ----------
    engine, tables, coefficients
        As of :class:`Kernel`.
    room : Room
    """

    def __init__(
        self, engine: Engine, tables: Callable[[Array], dict[str, Any]], coefficients: int, room: Room
    ) -> None:
        self.room = room
        self._slots: dict[tuple[int, int], slice] = {}
        at = 1 + FRAME
        for known, link in room.forces:
            self._slots[id(known.function), link] = slice(at, at + 3 + known.constants)
            at += 3 + known.constants
        # a force that does not act takes ones, by which it may divide
        self._idle = np.ones(at)
        self._idle[[place.start for place in self._slots.values()]] = 0.0
        super().__init__(engine, lambda values: self._roomy(tables(values)), coefficients)

    def _roomy(self, tables: dict[str, Any]) -> dict[str, Any]:
        """Tables with NaN where a run has numbers of its own."""
        found = dict(tables)
        for name, links in self.room.rows.items():
            own = tables[name]
            found[f"{name}_link"] = np.append(tables[f"{name}_link"], np.array(links, dtype=np.int64))
            found[name] = np.vstack([own, np.full((len(links), own.shape[1]), np.nan)])
        for name, places in self.room.filled.items():
            found[name] = found[name].copy()
            found[name][places] = np.nan
        return {**found, ACTING: np.full(len(self._idle), np.nan)}

    def widened(
        self, tables: Mapping[str, Any], forces: Sequence[Force], frame: Array, begin_s: float
    ) -> dict[str, Any] | None:
        """A run's tables as this kernel takes them; None where it has no room for them.

        Parameters
        ----------
        tables : mapping
            As the engine takes them.
        forces : sequence of Force
        frame : ndarray, shape (7,)
            Where the forces find the run, as the engine has it.
        begin_s : float
            Time of the first state.
        """
        found = dict(tables)
        for name in self.room.rows:
            links = self._example[f"{name}_link"]
            rows = _in_places(tables[name], tables[f"{name}_link"], links)
            if rows is None:
                return None
            found[name], found[f"{name}_link"] = rows, links
        acting = self._idle.copy()
        acting[0], acting[1 : 1 + FRAME] = begin_s, frame
        count = len(found["topology"])
        for force in forces:
            place = self._slots.get((id(force.function), force.link % count))
            if place is None or acting[place.start] != 0.0:
                return None
            acting[place] = 1.0, force.x, force.y, *force.constants
        found[ACTING] = acting
        return found if self.fits(found) else None

    def kind(self, table: str) -> str:
        """Numbers of which nothing is known, also not whether they are there (see :meth:`Kernel.kind`)."""
        return "number" if table == ACTING else super().kind(table)

    def _arguments(self, tracer: tracing.Tracer, tables: dict[str, Any]) -> list[Any]:
        acting = tables.pop(ACTING)
        slots = [acting[place] for place in self._slots.values()]
        constants = [np.append(slot[:1], slot[3:]) for slot in slots]
        calls = self._calls()

        def call(*arguments: Any) -> None:
            next(calls)(*arguments)

        forced = (
            [link for _, link in self.room.forces],
            np.array([slot[1:3] for slot in slots], dtype=object).reshape(-1, 2),
            np.concatenate([np.empty(0, dtype=object), *constants]),
            np.concatenate(([0], np.cumsum([len(own) for own in constants]))).astype(int),
            acting[1 : 1 + FRAME],
            *(np.zeros(3, dtype=object) for _ in range(3)),
            *(call,) * 4,
        )
        time = acting[0] + tracer.symbol("elapsed", 0)
        return [*tables.values(), forced, time]

    def _calls(self) -> Iterator[Callable[..., None]]:
        """The forces on symbols, each nothing where it does not act."""
        for known, _ in self.room.forces:
            plain = tracing.on_symbols(known.function)

            def call(time: Any, pose: Any, velocity: Any, own: Any, wrench: Any, plain: Any = plain) -> None:
                plain(time, pose, velocity, own[1:], wrench)
                wrench[:] = [tracing.positive(own[0], part, 0.0) for part in wrench]

            yield call


def _in_places(rows: Array, links: NDArray[np.int64], places: NDArray[np.int64]) -> Array | None:
    """Rows of elements each at the next place of its link, zeros between; None where there is no place."""
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
