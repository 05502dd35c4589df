"""Markers that are lost or mistaken."""

from __future__ import annotations

from collections.abc import Sequence

from swimid.effects.base import Effect
from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial


class MarkerDropout(Effect):
    """Stretches in which the tracker froze, jumped to something else or strayed.

    No simulation contains it: it is found in the samples themselves, by their being frozen,
    displaced or far outside the noise.
    """

    name = "marker-dropout"
    meaning = "For some stretches the tracker lost the markers or followed something else."
    sources = (
        "tendon fish, section V.A (failed detection of the colour labels at 4 s)",
        "sea lion, section II (two markers tracked)",
    )
    needs = frozenset()

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """None: nothing is simulated."""
        return []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """None."""
        return ()

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """None."""
        return NONE
