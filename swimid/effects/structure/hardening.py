"""A spring that is stiffer the farther it is bent."""

from typing import Any

import numpy as np
from numba import cfunc

from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter
from swimid.fitting.hooks import FORCE_SIGNATURE, Force

#: Deflection of a joint that no log shows, rad.
USUAL_ANGLE = 0.3


@cfunc(FORCE_SIGNATURE, cache=True)
def cubic(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """``-k_3 (x - rest)^3``; constants cubic stiffness and rest position."""
    off = pose[0] - constants[1]
    wrench[0] -= constants[0] * off * off * off


class Hardening(Effect):
    """``-K (1 + h q^2) q``, Duffing's spring: at the passive joints that have one, or of a free decay.

    K is the model's stiffness at small deflections q, ``h < 0`` a spring that softens (the restoring moment
    of a roll goes with the sine: ``h = -1/6`` per rad^2).
    """

    name = "hardening"
    meaning = "stiffness that grows with deflection"
    sources = (
        "tendon fish paper, Eqs 3 and 4",
        "Kovacic and Brennan 2011, The Duffing Equation, chapter 2",
    )
    needs = frozenset({"tables", "force"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers with a spring in a joint, and decays."""
        body = model.body
        if body is not None:
            tables = body.tables()
            return [self] if any(body.stiffness(tables, k) > 0 for k in range(len(body.passive))) else []
        return [self] if model.rig is not None and model.rig.swings else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Growth with squared deflection, rad^-2 or m^-2.

        A fifth more torque at the largest deflection is what one begins to see; a spring that softens keeps a
        stiffness above zero out to there, ``1 + 3 h q^2 > 0``.
        """
        largest = _deflection(model, trials)
        unit = "rad" if model.rig is None else model.rig.displacement.unit
        size, least = 0.2 / largest**2, -1.0 / (3.0 * largest**2)
        words = "growth of the stiffness with squared deflection"
        return (parameter(f"hardening_{unit}_2", f"{unit}^-2", size, words, lower=least, upper=30.0 * size),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds a cubic term to the springs."""
        body = model.body
        if body is not None:

            def springs(tables: dict[str, Any]) -> None:
                for k in range(len(body.passive)):
                    body.stiffen(tables, k, cubic=max(body.stiffness(tables, k), 0.0) * values[0])

            return Hooks(tables=(springs,))
        constants = np.zeros(2)

        def take(c: dict[str, float]) -> None:
            constants[:] = c["stiffness"] * values[0], c["rest"]

        return Hooks(coefficients=(take,), force=(Force(cubic, constants),))


def _deflection(model: Model, trials: Trials) -> float:
    """Largest deflection of a typical trial, in the unit of the coordinate."""
    if model.body is None:
        return 0.5 * model.scales(trials).span
    columns = [axis.column for axis in model.body.passive]
    seen = [np.abs(t.measured[c]) for t in trials for c in columns if c in t.measured]
    found = [float(np.nanmax(s)) for s in seen if np.isfinite(s).any()]
    return (float(np.median(found)) if found else 0.0) or USUAL_ANGLE
