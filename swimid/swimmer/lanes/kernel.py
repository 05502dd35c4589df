"""Compiled kernels of a robot, which integrate a batch of simulations at once. They are stored on disk.

A kernel is the code of an engine (the equations of motion) specialised for one robot. :class:`Kernel` holds
the equations of the robot alone, :class:`WideKernel` those with the forces and elements of effects.
:class:`Kernels` has both, and chooses one of them for each simulation. Without a kernel, the scalar engine
computes one simulation at a time.
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
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import llvmlite  # type: ignore[import-untyped]
import numba
import numpy as np
from numba.core.codegen import get_host_cpu_features
from numba.misc.appdirs import user_cache_dir
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.fitting.model import Force, Traceable
from swimid.notices import Progress, silent
from swimid.swimmer.lanes import tracing
from swimid.swimmer.lanes.tracing import LANES, Traced

if TYPE_CHECKING:
    from swimid.files.atomic import Checkpoint
    from swimid.swimmer.model import Run

Array = NDArray[np.float64]

#: Time of one operation in the scalar engine, and time to compile one operation, s. Measured with the built-
#: in robots by ``python -m benchmarks.bench_lanes --only engine compile``.
OPERATION_S, COMPILING_S = 3.5e-10, 5e-3
#: Maximum simulation time with the scalar engine, s, for which kernels are not used.
MAX_SCALAR_S = 0.5
#: Minimum ratio of the simulation time with the scalar engine to the compilation time at which a kernel is
#: compiled at once. The amount of simulation is known in advance only within a factor of two.
MIN_GAIN = 2.0
#: Maximum age of a compilation mark, s. The process that set an older mark is taken to have stopped.
MARK_S = 600.0
#: Maximum number of result arrays that are reused by later batches.
N_BUFFERS = 8


class Kernel:
    """Compiled equations of motion of one robot, which integrate up to :data:`LANES` simulations at once.

    Parameters
    ----------
    engine : module
        Compiled equations of motion: ``planar.engine`` or ``spatial.engine``.
    tables : callable
        Function of the coefficients. It returns the input arrays of the engine by name.
    coefficients : int
        Number of coefficients.
    """

    def __init__(
        self, engine: ModuleType, tables: Callable[[Array], dict[str, Any]], coefficients: int
    ) -> None:
        self.engine = engine
        self._example = tables(np.ones(coefficients))
        self.size, self._scratch = engine.shapes(self._example)
        self.fixed = _fixed(tables, coefficients)
        for name, columns in engine.FILLED.items():
            self.fixed[name][:, columns] = np.nan
        entries = self._entries(self.fixed)
        self._taken, self._known = np.flatnonzero(np.isnan(entries)), np.flatnonzero(~np.isnan(entries))
        self._structure = entries[self._known]
        self._lock = threading.RLock()
        self._buffers: list[Array] = []
        self._traced: Traced | None = None
        self.module: ModuleType | None = None

    def fits(self, tables: Mapping[str, Any]) -> bool:
        """Return whether ``tables`` has the constant entries of this robot, so that the kernel applies.

        The result is False if an effect has changed an entry that is constant in the kernel.
        """
        for name, example in self._example.items():
            given = tables[name]
            if name in self.fixed:
                if np.shape(given) != np.shape(example):
                    return False
            elif given is not example and not np.array_equal(given, example):
                return False
        return bool((self._entries(tables)[self._known] == self._structure).all())

    def traced(self) -> Traced:
        """Return the equations of motion as operations on symbols."""
        if self._traced is None:
            self._traced = self._trace()
        return self._traced

    def _trace(self) -> Traced:
        tracer = tracing.Tracer()
        arguments: dict[str, Any] = {}
        count = 0
        for name, example in self._example.items():
            fixed = self.fixed.get(name)
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
        """Return the kind of input symbol for the entries of an input array (see :class:`tracing.Symbol`)."""
        return "table"

    def _arguments(self, tracer: tracing.Tracer, tables: dict[str, Any]) -> list[Any]:
        """Return the arguments of the derivative: the input arrays and the arguments that follow them."""
        return [*tables.values(), *self.engine.LAST]

    def worth(self, derivatives: float, progress: Progress = silent) -> bool:
        """Return whether the kernel saves time, and compile it if it does.

        It saves time if it is stored on this machine already, or if compiling it takes less time than it
        saves. Otherwise a process in the background compiles it for the next command. The environment
        variable ``SWIMID_LANES`` overrides this decision with ``always`` or ``never``. Results of the kernel
        and the scalar engine agree to about fourteen digits.

        Parameters
        ----------
        derivatives : float
            Expected number of evaluations of the equations of motion.
        progress : Progress
        """
        wanted = os.environ.get("SWIMID_LANES", "auto")
        if wanted == "never":
            return False
        operations = len(self.traced().operations)
        scalar_s = derivatives * OPERATION_S * operations
        if wanted == "auto" and scalar_s < MAX_SCALAR_S:
            return False
        text = tracing.text(self.traced())
        if on_disk(text):
            self.compiled()
            return True
        if wanted == "auto" and scalar_s < MIN_GAIN * COMPILING_S * operations:
            compile_later(text)
            return False
        with progress("compiling the simulation for several runs at once (on first use only)"):
            self.compiled()
        return True

    def compiled(self) -> ModuleType:
        """Return the compiled module. Compile it if this machine does not have it yet."""
        with self._lock:
            if self.module is None:
                self.module = imported(tracing.text(self.traced()))
                self.module.integrate.compile(self.module.SIGNATURE)
            return self.module

    def run(
        self,
        starts: Sequence[Array],
        steps_s: Sequence[float],
        drives: Sequence[Array],
        tables: Sequence[Mapping[str, Any]],
    ) -> list[tuple[Array, Array]]:
        """Return states and rates of each simulation, as ``engine.integrate`` does.

        Parameters
        ----------
        starts : sequence of ndarray, shape (size,)
            Initial states.
        steps_s : sequence of float
        drives : sequence of ndarray, shape (2 steps + 1, driven joints, 5)
        tables : sequence of mappings
            Input arrays of each simulation, for which :meth:`fits` must be true.

        Returns
        -------
        list of (states, rates), each shape (steps + 1, size)
        """
        module, traced = self.compiled(), self.traced()
        found: dict[int, tuple[Array, Array]] = {}
        # simulations of similar length share a batch
        order = sorted(range(len(starts)), key=lambda k: len(drives[k]))
        for first in range(0, len(order), LANES):
            batch = order[first : first + LANES]
            lanes = [*batch, *[batch[0]] * (LANES - len(batch))]
            steps = [(len(drives[k]) - 1) // 2 for k in batch]
            states, rates = self._buffer((2, len(batch), max(steps) + 1, self.size))
            module.integrate(
                np.stack([starts[k] for k in lanes], axis=-1).reshape(-1),
                np.array([steps_s[k] for k in lanes], dtype=float),
                *(np.ascontiguousarray(drives[k]).reshape(len(drives[k]), -1) for k in lanes),
                all(drives[k] is drives[batch[0]] for k in batch),
                max(steps),
                np.stack([self.numbers(tables[k]) for k in lanes], axis=-1).reshape(-1),
                states,
                rates,
                np.empty(tracing.length(traced)),
            )
            for j, k in enumerate(batch):
                found[k] = states[j, : steps[j] + 1], rates[j, : steps[j] + 1]
        return [found[k] for k in range(len(starts))]

    def _buffer(self, shape: tuple[int, ...]) -> Array:
        """Return an array to write into, from memory that no earlier result uses any more.

        With newly allocated memory, a simulation would take one and a half times as long because of page
        faults.
        """
        need = math.prod(shape)
        with self._lock:
            counts = _references(self._buffers)
            idle = [k for k, n in enumerate(counts) if n == IDLE and len(self._buffers[k]) >= need]
            if not idle:
                self._buffers = [np.empty(need), *self._buffers[: N_BUFFERS - 1]]
                idle = [0]
            return self._buffers[idle[0]][:need].reshape(shape)

    def numbers(self, tables: Mapping[str, Any]) -> Array:
        """Return the entries of ``tables`` that are inputs of the kernel, shape (parameters,)."""
        return self._entries(tables)[self._taken]

    def _entries(self, tables: Mapping[str, Any]) -> Array:
        """Return all entries of the input arrays in one array."""
        return np.concatenate([np.reshape(tables[name], -1) for name in self.fixed])


def _references(arrays: Sequence[Array]) -> list[int]:
    """Return the number of references to each array."""
    return [sys.getrefcount(array) for array in arrays]


#: Reference count of an array that is referenced only by a list.
IDLE = _references([np.empty(0)])[0]


def _fixed(tables: Callable[[Array], dict[str, Any]], coefficients: int) -> dict[str, Array]:
    """Return the input arrays with NaN for entries that are not 0, 1 or -1 for all coefficients."""
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


def _used(operations: Sequence[tracing.Symbol], results: Any) -> list[tracing.Symbol]:
    """Return the operations on which the results depend, in their order."""
    needed, open_ = set(), [x for x in results if isinstance(x, tracing.Symbol)]
    while open_:
        x = open_.pop()
        if x.number not in needed:
            needed.add(x.number)
            open_ += [a for a in x.of if isinstance(a, tracing.Symbol)]
    return [x for x in operations if x.number in needed]


def folder() -> Path:
    """Return the folder of generated modules and their compiled forms, next to the other caches of numba."""
    beside = Path(__file__).parent / "__pycache__"
    if numba.config.CACHE_DIR:
        base = Path(numba.config.CACHE_DIR)
    elif os.access(beside if beside.exists() else beside.parent, os.W_OK):
        base = beside
    else:
        base = Path(user_cache_dir("swimid"))
    return base / "lanes"


def _path(text: str) -> Path:
    """Return the path of a module. Its name is a hash of the text, the compiler and the processor."""
    host = f"{sys.version} {numba.__version__} {llvmlite.__version__} {get_host_cpu_features()}"
    return folder() / f"lanes_{hashlib.sha256(f'{host} {text}'.encode()).hexdigest()[:16]}.py"


def on_disk(text: str) -> bool:
    """Return whether the module with this text is compiled on this machine."""
    path = _path(text)
    base = Path(numba.config.CACHE_DIR) if numba.config.CACHE_DIR else path.parent / "__pycache__"
    return any(base.rglob(f"{path.stem}.integrate-*.nbc"))


def imported(text: str) -> ModuleType:
    """Return the module with this text, and write its file if there is none.

    The module is compiled at its first call.
    """
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


def compile_later(text: str) -> None:
    """Compile a module for the next command, in a process that outlives this process."""
    imported(text)
    command = "import sys; from swimid.swimmer.lanes import kernel; kernel.compile_file(sys.argv[1])"
    with contextlib.suppress(OSError):  # without a process the next command is as slow as this one
        subprocess.Popen(
            [sys.executable, "-c", command, str(_path(text))],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )


def compile_file(path: str) -> None:
    """Compile the module at a path at low priority, unless another process does so already."""
    mark = Path(path).with_suffix(".compiling")
    if mark.exists() and time.time() - mark.stat().st_mtime > MARK_S:
        mark.unlink(missing_ok=True)
    try:
        mark.touch(exist_ok=False)
    except FileExistsError:
        return
    try:
        if hasattr(os, "nice"):
            os.nice(10)
        module = imported(Path(path).read_text(encoding="utf-8"))
        module.integrate.compile(module.SIGNATURE)
    finally:
        mark.unlink(missing_ok=True)


#: Name of the input array with the external forces in a simulation. Its entries are the start time (s), the
#: coordinate frame (``placed`` of the engine), and for each force: 1 or 0 (whether the force acts), its point
#: and its constants.
ACTING = "acting"
#: Number of entries for the coordinate frame.
FRAME = 7


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


class WideKernel(Kernel):
    """Compiled equations of motion of one robot with effects. Each simulation has its own effects or none.

    One kernel serves all effects, because compiling takes seconds. A simulation also computes the forces of
    effects that it does not have. This costs little compared with a simulation by the scalar engine.

    Parameters
    ----------
    engine, tables, coefficients
        See :class:`Kernel`.
    room : Room
        Elements, entries and forces of the effects.
    """

    def __init__(
        self, engine: ModuleType, tables: Callable[[Array], dict[str, Any]], coefficients: int, room: Room
    ) -> None:
        self.room = room
        self._slots: dict[tuple[int, int], slice] = {}
        at = 1 + FRAME
        for known, link in room.forces:
            self._slots[id(known.function), link] = slice(at, at + 3 + known.constants)
            at += 3 + known.constants
        # the constants of a force that does not act are ones, because the force may divide by them
        self._idle = np.ones(at)
        self._idle[[place.start for place in self._slots.values()]] = 0.0
        super().__init__(engine, lambda values: self._roomy(tables(values)), coefficients)

    def _roomy(self, tables: dict[str, Any]) -> dict[str, Any]:
        """Return input arrays with NaN for the entries that effects may change."""
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
        """Return the input arrays of a simulation in the form of this kernel; None if its effects do not fit.

        Parameters
        ----------
        tables : mapping
            Input arrays of the equations of motion.
        forces : sequence of Force
        frame : ndarray, shape (7,)
            Coordinate frame of the simulation in the world (``placed`` of the engine).
        begin_s : float
            Time of the initial state.
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
        """Return the kind of input symbol for the entries of an input array.

        Entries for forces have a kind of their own, because even their signs are unknown.
        """
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
        """Yield the forces as functions of symbols. A force that does not act is zero."""
        for known, _ in self.room.forces:
            plain = tracing.on_symbols(known.function)

            def call(time: Any, pose: Any, velocity: Any, own: Any, wrench: Any, plain: Any = plain) -> None:
                plain(time, pose, velocity, own[1:], wrench)
                wrench[:] = [tracing.positive(own[0], part, 0.0) for part in wrench]

            yield call


def _in_places(rows: Array, links: NDArray[np.int64], places: NDArray[np.int64]) -> Array | None:
    """Return rows of elements, each moved to the next row of ``places`` for its link.

    Rows without an element are zero. The result is None if a link has too few rows.
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
    """Kernels of one robot: one for the robot alone, and one for simulations with effects.

    Parameters
    ----------
    engine, tables, coefficients
        See :class:`Kernel`.
    room : callable
        Function that returns the :class:`Room` for effects, or None if there are none.

    Attributes
    ----------
    own, wide : Kernel, WideKernel or None
        Kernels for the robot alone and with effects. They are created when first needed.
    use_own, use_wide : bool
        Whether simulations use these kernels. Otherwise they use the scalar engine.
    """

    def __init__(
        self,
        engine: ModuleType,
        tables: Callable[[Array], dict[str, Any]],
        coefficients: int,
        room: Callable[[], Room | None],
    ) -> None:
        self._made = engine, tables, coefficients
        self._room = room
        self.own: Kernel | None = None
        self.wide: WideKernel | None = None
        self.use_own = self.use_wide = False

    def make(self, *, effects: bool = True) -> Kernel:
        """Create the kernels without compiling them, and return the kernel of the robot alone."""
        self.own = self.own or Kernel(*self._made)
        if effects and self.wide is None:
            room = self._room()
            if room is not None:
                self.wide = WideKernel(*self._made, room)
        return self.own

    def prepare(
        self,
        name: str,
        derivatives: float,
        affected: float,
        checkpoint: Checkpoint | None,
        progress: Progress = silent,
    ) -> None:
        """Decide whether simulations use the kernels, and compile those that are used.

        Parameters
        ----------
        name : str
            Name of the decision in the checkpoint.
        derivatives, affected : float
            Expected number of evaluations of the equations of motion, without and with effects.
        checkpoint : Checkpoint, optional
            Storage of the decision. A resumed search repeats its decision, because results of kernel and
            scalar engine differ in the last digits.
        progress : Progress
        """
        own = self.make(effects=affected > 0.0)
        begun = None if checkpoint is None else checkpoint.get(name)
        if begun is not None:
            self.use_own, self.use_wide = bool(begun[0]), bool(begun[1])
            return
        self.use_own = own.worth(derivatives, progress)
        if self.use_own and self.wide is not None:
            self.use_wide = self.wide.worth(affected, progress)
        if checkpoint is not None:
            checkpoint.put(name, np.array([self.use_own, self.use_wide], dtype=float))

    def choose(self, run: Run, frame: Callable[[Run], Array]) -> tuple[Kernel, Mapping[str, Any]] | None:
        """Return the kernel for a simulation with its input arrays; None if the scalar engine is needed.

        Parameters
        ----------
        run : Run
        frame : callable
            Function from a simulation to its coordinate frame in the world, shape (7,).
        """
        if self.own is None or not self.use_own:
            return None
        if not run.hooks.force and (not run.hooks.tables or self.own.fits(run.tables)):
            return self.own, run.tables
        if self.wide is None or not self.use_wide:
            return None
        tables = self.wide.widened(run.tables, run.hooks.force, frame(run), run.grid.begin_s)
        return None if tables is None else (self.wide, tables)

    def run(self, runs: Mapping[Any, Run], frame: Callable[[Run], Array]) -> dict[Any, tuple[Array, Array]]:
        """Return states and rates of the simulations that the kernels can compute, by key of ``runs``."""
        found: dict[Any, tuple[Array, Array]] = {}
        choices = {key: self.choose(run, frame) for key, run in runs.items()}
        for kernel in (self.own, self.wide):
            taken = {key: choice[1] for key, choice in choices.items() if choice and choice[0] is kernel}
            if kernel is None or not taken:
                continue
            motions = kernel.run(
                [runs[key].start for key in taken],
                [runs[key].grid.step_s for key in taken],
                [runs[key].drive.table for key in taken],
                list(taken.values()),
            )
            found.update(zip(taken, motions, strict=True))
        return found
