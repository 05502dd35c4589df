"""Reactive force of a fin: momentum shed at its trailing edge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.swimmer.planar.model import MultilinkModel

#: Most added mass per length, in those of the plate that gives the scale.
MOST = 10.0


class WakeLift(Effect):
    """``-m u w n + m w^2 t / 2`` at the rear end of the last link.

    u and w are the edge's velocities along and across its link, m the added mass per length there
    (:mod:`swimid.swimmer.planar.elements.trailing_edge`).
    """

    name = "wake-lift"
    stage = "fluid"
    meaning = "reactive force of the fin: momentum shed into the wake"
    sources = ("Lighthill 1971, Proc. R. Soc. Lond. B 179:125",)
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Swimmers of several links."""
        fits = isinstance(model, MultilinkModel) and len(model.assembly.links) > 1
        return [self] if fits else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Added mass per length at the edge, kg/m, against a plate as high as the last link is long."""
        assert isinstance(model, MultilinkModel)
        chord = model.assembly.links[-1].length_m
        plate = 0.25 * math.pi * model.robot.fluid.density_kg_m3 * chord**2
        return (
            Parameter(
                "added_mass_kg_m",
                "kg/m",
                0.0,
                MOST * plate,
                0.0,
                0.1 * plate,
                meaning="added mass per length at the trailing edge",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds a trailing edge."""
        assert isinstance(model, MultilinkModel)
        last = len(model.assembly.links) - 1
        row = [-model.assembly.links[last].length_m, 0.0, 0.5 * values[0]]

        def add(tables: dict[str, Any]) -> None:
            tables["wake_link"] = np.append(tables["wake_link"], last)
            tables["wake"] = np.vstack([tables["wake"], row])

        return Hooks(tables=(add,))
