"""Choice of the integration step of a model: it is halved until the simulated samples hardly change.

Every command that simulates chooses the step by :func:`choose_step`, once for all its simulations of a trial.
The derivatives of a fit are then smooth, because all of its simulations of a trial have the same step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from swimid.fitting.model import Array, Model, Trial

#: Maximum change of a simulated sample when the integration step is halved, for which the step counts as
#: small enough: in standard deviations of the noise, and if the noise is unknown as a fraction of the range
#: of the channel.
STEP_ERROR, STEP_LIMIT = 0.1, 1e-3
#: Maximum number of times that the integration step is halved.
MAX_REFINEMENTS = 6
#: Range of a channel below which nothing moves in it, in the unit of the channel.
MIN_RANGE = 1e-9

#: Standard deviations of the noise of one trial, by channel: one value, or one value for each sample.
Noise = Mapping[str, Any]


class StepChoice(NamedTuple):
    """Model with the chosen integration step, and the accuracy of its simulations.

    Attributes
    ----------
    model : Model
    changes : list of dict of str to float
        Maximum change of a sample when the step is halved, divided by the maximum allowed change, for each
        simulation and channel. It is infinite if the simulation breaks down. It is empty if the model does
        not integrate.
    halvings: int
        Number of times that the step was halved.
    """

    model: Model
    changes: list[dict[str, float]]
    halvings: int

    @property
    def change(self) -> float:
        """Maximum of :attr:`changes`. The step is small enough if it is at most 1."""
        return max((_largest(changes) for changes in self.changes), default=0.0)


def choose_step(
    model: Model,
    runs: Sequence[tuple[Array, Trial]],
    noise: Sequence[Noise] = (),
    *,
    halvings: int = MAX_REFINEMENTS,
) -> StepChoice:
    """Halve the integration step of a model until its simulations are accurate and do not break down.

    A simulation is accurate if no sample changes by more than a tenth of its noise when the step is halved. A
    channel of unknown noise may change by a thousandth of its range. If a trial has measured channels, only
    those count. A simulation that breaks down with every step has no effect on the choice.

    Parameters
    ----------
    model : Model
        Model with the maximum step.
    runs : sequence of (values, trial)
        Simulations for which the step is chosen.
    noise : sequence of mapping, optional
        Standard deviations of the noise of each simulation, by channel.
    halvings : int
        Maximum number of times that the step is halved. With 0 the step is only tested.
    """
    noise = noise or [{}] * len(runs)
    changes: list[dict[str, float]] = [{} for _ in runs]
    levels, models, rest = [0] * len(runs), [model], list(range(len(runs)))
    rough = model.run_many(runs) if model.refine() is not None else []
    while rest and (finer := models[-1].refine()) is not None:
        fine = finer.run_many([runs[k] for k in rest])
        for k, one, other in zip(rest, rough, fine, strict=True):
            changes[k] = _changes(runs[k][1], one, other, noise[k])
        left = [(k, other) for k, other in zip(rest, fine, strict=True) if _largest(changes[k]) > 1.0]
        rest, rough = [k for k, _ in left], [other for _, other in left]
        if len(models) > halvings:
            break
        models.append(finer)
        for k in rest:
            levels[k] += 1
    chosen = max((k for k, one in zip(levels, changes, strict=True) if _largest(one) < math.inf), default=0)
    return StepChoice(models[chosen], changes, chosen)


def _largest(changes: Mapping[str, float]) -> float:
    """Return the largest change of a simulation; 0 if it has none."""
    return max(changes.values(), default=0.0)


def is_broken_down(trial: Trial, simulated: Mapping[str, Array]) -> bool:
    """Return whether a simulation breaks down before the inputs of its trial end."""
    lost = any(not np.isfinite(values[-1]) for values in simulated.values())
    return lost and all(np.isfinite(values[-1]) for values in trial.inputs.values())


def _changes(
    trial: Trial, rough: Mapping[str, Array], fine: Mapping[str, Array], noise: Noise
) -> dict[str, float]:
    """Return the changes of the channels of one simulation (see :attr:`StepChoice.changes`)."""
    names = [name for name in rough if name in trial.measured] or list(rough)
    if is_broken_down(trial, rough):
        return dict.fromkeys(names, math.inf)
    found = {}
    for name in names:
        both = np.isfinite(rough[name]) & np.isfinite(fine[name])
        span = float(np.ptp(rough[name][both])) if both.any() else 0.0
        if name in noise:
            allowed = STEP_ERROR * np.broadcast_to(noise[name], both.shape)[both]
        elif span > MIN_RANGE:
            allowed = np.array(STEP_LIMIT * span)
        else:
            continue
        shares = np.abs(fine[name] - rough[name])[both] / allowed
        found[name] = float(np.max(shares[np.isfinite(shares)], initial=0.0))
    return found
