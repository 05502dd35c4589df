"""The compiled lanes of a robot with room for what effects bring: forces, more elements, shifted masses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.fitting.hooks import Force, Traceable
from swimid.swimmer.lanes import symbols
from swimid.swimmer.lanes.kernel import Array, Engine, Kernel

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

    def _arguments(self, tracer: symbols.Tracer, tables: dict[str, Any]) -> list[Any]:
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
            plain = symbols.on_symbols(known.function)

            def call(time: Any, pose: Any, velocity: Any, own: Any, wrench: Any, plain: Any = plain) -> None:
                plain(time, pose, velocity, own[1:], wrench)
                wrench[:] = [symbols.positive(own[0], part, 0.0) for part in wrench]

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
