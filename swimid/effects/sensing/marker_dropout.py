"""Markers that are lost or mistaken."""

from swimid.effects.base import Array, Effect, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.hooks import NONE


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

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """None: nothing is simulated, so that it applies to no model."""
        return ()

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """None."""
        return NONE
