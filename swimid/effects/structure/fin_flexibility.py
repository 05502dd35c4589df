"""A fin that bends under its load."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter
from swimid.fitting.hooks import Force, Stroke, traceable


@traceable(on="last", constants=3)
def bent_fin(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """What bending adds to the fin's normal force; constants compliance, quadratic and lift gain.

    The straight fin's normal force ``N = -(k |w| + l u) w`` turns its chord by
    ``delta = -c N / sqrt(1 + (c N)^2)``; the bent fin's acts across its own chord, on the motion across it.
    """
    compliance, quadratic, lift = constants[0], constants[1], constants[2]
    u, w = velocity[0], velocity[1]
    straight = -(quadratic * abs(w) + lift * abs(u)) * w
    bend = -compliance * straight
    bend /= math.sqrt(1.0 + bend * bend)
    c, s = math.cos(bend), math.sin(bend)
    along, across = c * u + s * w, c * w - s * u
    bent = -(quadratic * abs(across) + lift * abs(along)) * across
    wrench[0] -= bent * s
    wrench[1] += bent * c - straight


class FinFlexibility(Effect):
    """The caudal fin bends in proportion to the force across it (quasi-static, first bending mode).

    A swimmer's fin turns its chord by compliance times load, which tilts the force forwards and unloads
    it; a model of the average over a beat loses thrust by ``1 / (1 + kappa L)`` with the load
    ``L = I f^2 theta`` over its typical size.

    Parameters
    ----------
    load, inertia_kg_m2 : float
        Typical ``I f^2 theta`` of the trials, and the inertia taken for a fin whose own is not known.
    """

    name = "fin-flexibility"
    meaning = "caudal fin that bends under its load"
    sources = ("dolphin paper, section 1", "Katz and Weihs 1978, J. Fluid Mech. 88:485")
    needs = frozenset({"force", "stroke"})

    def __init__(self, load: float = 1.0, inertia_kg_m2: float = 1.0) -> None:
        self.load, self.inertia_kg_m2 = load, inertia_kg_m2

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers whose last link has drag or lift across it, and models of the stroke."""
        body = model.body
        if body is not None:
            return [self] if sum(body.fin(body.tables())[:2]) > 0 else []
        return [FinFlexibility(*_typical(trials))] if "stroke" in model.offers else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Chord angle per force, rad/N; or loss per load, 1."""
        body = model.body
        if body is not None:
            quadratic, lift, _ = body.fin(body.tables())
            across = _stroke_speed(model, body.lengths_m[-1], trials)
            load = (quadratic * across + lift * model.scales(trials).speed) * across
            words = "angle by which the fin bends per force across it"
            most = 30.0 / load
            return (parameter("compliance_rad_N", "rad/N", 0.1 / load, words, lower=0.0, upper=most),)
        return (parameter("loss", "1", 0.2, "loss of thrust at the typical load", lower=0.0, upper=20.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A force on the last link, or a factor on the thrust."""
        body = model.body
        if body is not None:
            constants = np.array([values[0], 0.0, 0.0])
            x, y = body.fin(body.tables())[2]

            def read(tables: dict[str, Any]) -> None:
                constants[1:3] = body.fin(tables)[:2]

            return Hooks(tables=(read,), force=(Force(bent_fin, constants, body.last, x, y),))

        def weaken(stroke: Stroke) -> Stroke:
            inertia = stroke.inertia_kg_m2 if math.isfinite(stroke.inertia_kg_m2) else self.inertia_kg_m2
            load = inertia * stroke.frequency_hz**2 * np.abs(stroke.amplitude_rad) / self.load
            return replace(stroke, thrust=stroke.thrust / (1.0 + values[0] * load))

        return Hooks(stroke=(weaken,))


def _stroke_speed(model: Model, length: float, trials: Trials) -> float:
    """Typical speed of a fin of this length (m) across itself, m/s."""
    beats = [t.swim.beat for t in trials if t.swim.beat is not None]
    speeds = [2.0 * math.pi * b.frequency_hz * abs(b.amplitude_rad) * length for b in beats]
    return (float(np.median(speeds)) if speeds else 0.0) or model.scales(trials).speed


def _typical(trials: Trials) -> tuple[float, float]:
    """Median load and median inertia of the fins, 1 where that is not known."""
    known = [t.cruise.inertia_kg_m2 for t in trials if t.cruise.inertia_kg_m2 is not None]
    middle = float(np.median(known)) if known else 1.0
    loads = []
    for trial in trials:
        own = trial.cruise.inertia_kg_m2
        frequency, amplitude = (np.where(np.isnan(v), 1.0, v) for v in trial.steady)
        loads += list(np.square(frequency) * np.abs(amplitude) * (middle if own is None else own))
    return float(np.median(loads)) if loads else 1.0, middle
