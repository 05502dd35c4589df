"""A drag coefficient that changes with speed."""

from typing import Any

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.hooks import Force, traceable
from swimid.logs.log import FREQUENCY_RTOL

#: Less than any speed that can be told from none, m/s or rad/s: what has none has no drag.
TINY = 1e-30


@traceable(on="hull", constants=3)
def changed_drag(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """What ``C = C_0 (|u| / u_ref)^-n`` adds to ``-k u |u|``; constants k, n and u_ref."""
    u = velocity[0]
    speed = max(abs(u), TINY)
    wrench[0] -= constants[0] * u * abs(u) * ((speed / constants[2]) ** -constants[1] - 1.0)


class DragReynolds(Effect):
    """``C = C_0 (|u| / u_ref)^-n``: 0.5 is a laminar boundary layer, 0.2 a turbulent one.

    It acts on the axial drag, a swimmer's taken together at its heaviest link; or, by the mean speed of each
    trial, on all drag coefficients of a swimmer's links.

    Parameters
    ----------
    reference_m_s : float
        Speed u_ref at which the model's own coefficient holds (rad/s for an angle).
    whole : bool
        Whether all drag coefficients change, from trial to trial.
    """

    name = "drag-reynolds"
    meaning = "drag coefficient that falls with speed"
    sources = ("Schlichting and Gersten 2017, Boundary-Layer Theory, chapters 6 and 18",)
    needs = frozenset({"force"})
    smooth = True

    def __init__(self, reference_m_s: float = 0.3, *, whole: bool = False) -> None:
        self.reference_m_s = reference_m_s
        self.whole = whole

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs and free swimmers with quadratic drag, about the typical speed of the trials."""
        body = model.body
        if body is not None:
            fits = body.free and body.axial_drag(body.tables()) > 0
        else:
            fits = "force" in model.offers
        typical = model.scales(trials).speed
        forms: list[Effect] = [DragReynolds(typical)] if fits else []
        speeds = [model.scales([trial]).speed for trial in trials] if body is not None else []
        # trials of one speed, as near as those of one frequency, do not tell how drag changes with it
        if fits and speeds and max(speeds) > (1.0 + FREQUENCY_RTOL) * min(speeds):
            forms.append(DragReynolds(typical, whole=True))
        return forms

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The exponent n."""
        name = "trial_exponent" if self.whole else "exponent"
        words = "the drag coefficient falls as speed^-n"
        return (common.parameter(name, "1", 0.2, words, lower=-1.5, upper=1.5),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds the difference to the model's own quadratic drag, or changes its coefficients."""
        body = model.body
        if self.whole:
            whole = common.links(model)
            factor = (model.scales([trial]).speed / self.reference_m_s) ** -float(values[0])
            return Hooks(tables=(lambda tables: whole.drag_times(tables, factor),))
        constants = np.array([0.0, values[0], self.reference_m_s])
        if body is not None:

            def read(tables: dict[str, Any]) -> None:
                constants[0] = body.axial_drag(tables)

            return Hooks(tables=(read,), force=(common.at_hull(body, changed_drag, constants),))

        def take(c: dict[str, float]) -> None:
            constants[0] = c["quadratic"]

        return Hooks(coefficients=(take,), force=(Force(changed_drag, constants),))
