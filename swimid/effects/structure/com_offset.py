"""A centre of mass that is not where the model has it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.effects import common
from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.swimmer.planar.model import MultilinkModel


class ComOffset(Effect):
    """The heaviest link's mass moved along and across it, its inertia about the centre kept.

    Where the model has weights, the weight moves with it.
    """

    name = "com-offset"
    stage = "structure"
    meaning = "centre of mass of the hull off the model's"
    sources = ("sea lion paper, section on identification", "tendon fish paper, Table II")
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Free swimmers."""
        return [self] if common.swims_freely(model) else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Offsets forwards and to port (up in the vertical plane), m."""
        assert isinstance(model, MultilinkModel)
        length = model.assembly.links[common.hull(model)].length_m
        return tuple(
            Parameter(
                name,
                "m",
                -0.2 * length,
                0.2 * length,
                0.0,
                0.01 * length,
                meaning=f"centre of mass {words} of the model's",
            )
            for name, words in (
                ("along_m", "ahead"),
                ("across_m", "above" if common.vertical(model) else "to port"),
            )
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Moves the mass, and its weight."""
        assert isinstance(model, MultilinkModel)
        hull = common.hull(model)
        mass = float(common.rigid(model, hull)[0])
        x, y = common.centre(model, hull)
        a, b = float(values[0]), float(values[1])

        def move(tables: dict[str, Any]) -> None:
            common.weigh(tables, hull, (x, y), -mass, -mass)
            common.weigh(tables, hull, (x + a, y + b), mass, mass)
            at = np.array([x, y])
            force = tables["force"].copy()
            for row, link in zip(force, tables["force_link"], strict=True):
                if link == hull and row[4] == 1.0 and row[3] < 0.0 and np.allclose(row[:2], at, atol=1e-9):
                    row[:2] += a, b
            tables["force"] = force

        return Hooks(tables=(move,))
