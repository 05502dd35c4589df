"""Markers that do not sit where they are thought to."""

import math

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials

#: Farthest a marker may be off, m.
FARTHEST_M = 0.5


class MarkerOffset(Effect):
    """The tracked point lies beside the reference point, the tracked direction beside the heading.

    ``x + R(yaw) (along, across)`` less its value at the first sample, ``yaw + misalignment``, and
    the velocity of that point in the axes of that direction.
    """

    name = "marker-offset"
    meaning = "The markers sit off the robot's reference point, or are not aligned with its axis."
    sources = ("sea lion, section II (markers on the front and rear ends give pose and heading)",)
    needs = frozenset({"output"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The effect itself where a pose or a velocity of the body is measured."""
        body = common.free_body(model)
        if body is None:
            return []
        seen = common.measured((*body.pose, *body.velocity[:2]), trials)
        return super().variants(model, trials) if seen else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Place of the tracked point ahead of the reference point and to its side, m; its direction, rad."""
        return tuple(
            common.parameter(name, unit, size, words, lower=-most, upper=most)
            for name, unit, size, words, most in (
                ("along_m", "m", 0.01, "tracked point ahead of the reference", FARTHEST_M),
                ("across_m", "m", 0.01, "tracked point beside the reference", FARTHEST_M),
                ("heading_rad", "rad", 0.03, "tracked against true heading", math.pi),
            )
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Pose and velocity of the tracked point."""
        body = common.links(model)
        along, across, turn = (float(v) for v in values)
        (first, second, heading), (ahead, beside, rate) = body.pose, body.velocity

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            yaw, r = channels[heading], channels[rate]
            c, s = np.cos(yaw), np.sin(yaw)
            a, b = along * c - across * s, along * s + across * c
            u, v = channels[ahead] - across * r, channels[beside] + along * r
            # minus the unturned, so that no angle changes nothing at all
            cosine, sine = math.cos(turn) - 1.0, math.sin(turn)
            return {
                **channels,
                first: channels[first] + a - a[0],
                second: channels[second] + b - b[0],
                heading: yaw + turn,
                ahead: u + cosine * u + sine * v,
                beside: v + cosine * v - sine * u,
            }

        return Hooks(output=(seen,))
