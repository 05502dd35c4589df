"""A cable that pulls the robot back."""

import math

import numpy as np

from swimid.effects import common
from swimid.effects.base import SIZES, Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.hooks import Force, traceable

#: Less than any distance that can be told from none, m.
TINY = 1e-30


@traceable(on="base", constants=5)
def pull_back(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """A spring to a point of the world and a line that drags; stiffness, slack, line drag, the point."""
    dx, dy = pose[0] - constants[3], pose[1] - constants[4]
    distance = math.sqrt(dx * dx + dy * dy)
    u, v = velocity[0], velocity[1]
    drag = constants[2] * distance * math.sqrt(u * u + v * v)
    wrench[0] -= drag * u
    wrench[1] -= drag * v
    # at the anchor itself there is no direction, and no pull
    pull = constants[0] * max(distance - constants[1], 0.0) / max(distance, TINY)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] -= pull * (c * dx + s * dy)
    wrench[1] -= pull * (c * dy - s * dx)


class Tether(Effect):
    """``-k (d - slack)`` towards its anchor, d the distance from it, once d exceeds the slack.

    The anchor is where the run starts; that of a swimmer may lie behind it, so that the line pulls from the
    beginning. The line paid out drags, ``-c d v |v|``. A cruise feels the mean of the pull over the run.
    """

    name = "tether"
    meaning = "cable that pulls the robot back the more the farther it is"
    sources = ("dolphin paper, section 1",)
    needs = frozenset({"force", "coefficients"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Falling weights, towed bodies, cruises and free swimmers."""
        return [self] if common.pulled(model) or model.timed_runs or common.free_body(model) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Stiffness, N/m, slack, m; drag of the line, N s2/m3, for what moves in time; for a swimmer the
        distance of the anchor behind the start, m.
        """
        scales, size = model.scales(trials), _reach(model, trials)
        stiffness = 0.3 * scales.force / size
        pull = (
            common.parameter("stiffness_N_m", "N/m", stiffness, "pull of the tether per length", lower=0.0),
            common.parameter("slack_m", "m", 0.2 * size, "length before it pulls", lower=0.0, upper=size),
        )
        if model.timed_runs:
            return pull
        drag = 0.3 * scales.force / (size * scales.speed**2)
        words = "drag of the line per length"
        line = common.parameter("line_drag_N_s2_m3", "N s^2/m^3", drag, words, lower=0.0)
        if model.body is None:
            return (*pull, line)
        words = "distance of the anchor behind the start"
        return (*pull, line, common.parameter("behind_m", "m", 0.2 * size, words, lower=0.0, upper=size))

    def tries(self, parameters: Parameters) -> list[Array]:
        """A stiffness, without slack and with, or an anchor behind the start; a drag of the line."""
        scale = np.array([p.scale for p in parameters])
        steps = [(SIZES[1],), (SIZES[1], 2.0), (0.0, 0.0, SIZES[1]), (SIZES[1], 0.0, 0.0, 2.0)]
        return [
            scale * np.pad(step, (0, len(scale) - len(step))) for step in steps if len(step) <= len(scale)
        ]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A force on the base, or on the mean of a run."""
        if model.timed_runs:
            way = np.asarray(trial.inputs["distance_m"], dtype=float)
            mean = float(np.mean(0.5 * values[0] * np.maximum(way - values[1], 0.0) ** 2 / way))
            return common.more("dry", mean)
        if model.body is not None:
            *line, behind = values
            start_x, start_y, heading = trial.swim.posed()
            anchor = (start_x - behind * math.cos(heading), start_y - behind * math.sin(heading))
            x, y = model.body.reference_m
            return Hooks(force=(Force(pull_back, np.array([*line, *anchor]), x=x, y=y),))
        origin = trial.rig.x0
        return Hooks(force=(Force(pull_back, np.array([*values, origin, 0.0])),))


def _reach(model: Model, trials: Trials) -> float:
    """Typical distance from the start, m."""
    if model.timed_runs:
        ways = [w for t in trials for w in np.atleast_1d(t.inputs["distance_m"])]
        return float(np.median(ways)) or 1.0
    return model.scales(trials).span
