"""What may be hidden on the falling-weight rig: effects on one trial, in centimetres, grams and dynes.

Each has a form of its own: friction that falls with speed, a power law in place of a linear one, a string
between two masses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from validation.blind.common import ODD, PARAMETER, Catalogue

GRAVITY = 980.0
MASS, PULLEY, AREA, DENSITY, LENGTH, VISCOSITY = 1196.0, 20.0, 69.8, 0.997, 26.4, 0.0100
TRAVEL = 115.0
#: Speed at which effects on drag are sized, cm/s.
TYPICAL = 25.0


@dataclass
class Rig:
    """One trial: what pulls, what resists, what is seen."""

    weight: float
    drag: float
    added: float
    friction: float
    clicks: bool
    rng: np.random.Generator
    order: float = 0.0
    is_odd: bool = False
    speed: float = 0.0
    late: float = 0.0
    string: float | None = None
    forces: list[Callable[[float, float, float], float]] = field(default_factory=list)
    factors: list[Callable[[float, float], float]] = field(default_factory=list)
    inertia: list[Callable[[float], float]] = field(default_factory=list)
    flow: list[Callable[[float, float], tuple[float, float]]] = field(default_factory=list)
    seen: list[Callable[[np.ndarray, np.ndarray], np.ndarray]] = field(default_factory=list)

    def push(self, t: float, x: float, v: float) -> float:
        """Force on the body without the string's, dyn."""
        water, surge = 0.0, 0.0
        for flow in self.flow:
            w, rate = flow(t, x)
            water, surge = water + w, surge + rate
        resistance = self.drag * (v - water) * abs(v - water)
        for factor in self.factors:
            resistance *= factor(x, v)
        return (self.added + MASS) * surge - resistance + sum(f(t, x, v) for f in self.forces)

    def fall(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (s) every half millisecond and the displacement the encoder or camera sees, cm."""

        def stiff(_: float, s: np.ndarray) -> list[float]:
            x, v, p, q = s
            tension = self.string * (p - x) + 0.0006 * self.string * (q - v)  # type: ignore[operator]
            body = MASS + self.added + sum(i(x) for i in self.inertia)
            drop = self.weight * GRAVITY - self.friction * np.tanh(q / 0.05) - tension
            return [v, (tension + self.push(_, x, v)) / body, q, drop / (self.weight + PULLEY)]

        def rigid(t: float, s: np.ndarray) -> list[float]:
            x, v = s
            total = MASS + self.added + self.weight + PULLEY + sum(i(x) for i in self.inertia)
            pull = self.weight * GRAVITY - self.friction * np.tanh(v / 0.005)
            return [v, (pull + self.push(t, x, v)) / total]

        def arrived(_: float, s: np.ndarray) -> float:
            return s[0] - TRAVEL

        arrived.terminal = True  # type: ignore[attr-defined]
        start = [0.0, self.speed] if self.string is None else [0.0, self.speed, 0.0, self.speed]
        run = solve_ivp(
            rigid if self.string is None else stiff,
            (0.0, 40.0),
            start,
            method="DOP853",
            rtol=1e-7,
            atol=1e-7,
            max_step=0.1,
            events=arrived,
            dense_output=True,
        )
        t = np.arange(0.0, run.t[-1], 5e-4)
        x = run.sol(t)[0 if self.string is None else 2]
        stamp = t + self.late
        x = np.interp(t, stamp, x)
        for change in self.seen:
            x = change(t, x)
        return t, x


Act = Callable[[Rig], None]


def _pulley_friction(size: float, rng: np.random.Generator) -> Act:
    level, rise, slow = 300.0 * size, rng.uniform(0.2, 0.5), rng.uniform(3.0, 8.0)
    return lambda rig: rig.forces.append(
        lambda _, __, v: -level * (1.0 + rise * np.exp(-((abs(v) / slow) ** 1.5))) * np.tanh(v / 0.02)
    )


def _power_drag(level: float, power: float) -> Act:
    return lambda rig: rig.forces.append(lambda _, __, v: -level * np.sign(v) * (abs(v) / TYPICAL) ** power)


def _pulley_viscous(size: float, _: np.random.Generator) -> Act:
    return _power_drag(2500.0 * size, 1.3)


def _linear_drag(size: float, rng: np.random.Generator) -> Act:
    return _power_drag(3000.0 * size, rng.uniform(1.05, 1.3))


def _pulley_inertia(size: float, _: np.random.Generator) -> Act:
    # the string winds up on the drum: its inertia grows a little on the way
    return lambda rig: rig.inertia.append(lambda x: 130.0 * size * (1.0 + 0.15 * x / TRAVEL))


def _string_stretch(size: float, _: np.random.Generator) -> Act:
    def act(rig: Rig) -> None:
        rig.string = 40_000.0 / size

    return act


def _start_offset(size: float, rng: np.random.Generator) -> Act:
    sign = rng.choice([-1.0, 1.0])

    def act(rig: Rig) -> None:
        # a counter starts at its zero: a count cannot hide more than one click
        offset = 0.75 * (1.0 - np.exp(-size / 1.5)) if rig.clicks else 0.6 * size
        offset *= sign * rig.rng.normal(1.0, 0.06)
        rig.seen.append(lambda _, x: x + offset)

    return act


def _initial_speed(size: float, _: np.random.Generator) -> Act:
    def act(rig: Rig) -> None:
        rig.speed += 1.2 * size * rig.rng.normal(1.0, 0.08)

    return act


def _drag_reynolds(size: float, rng: np.random.Generator) -> Act:
    sign = rng.choice([1.0, 1.0, -0.6])

    def law(v: float) -> float:
        return float(np.log10(max(abs(v), 0.5) * LENGTH / VISCOSITY) - 2.0)

    return lambda rig: rig.factors.append(lambda _, v: (law(TYPICAL) / law(v)) ** (1.2 * sign * size))


def _added_mass(size: float, rng: np.random.Generator) -> Act:
    fade = rng.uniform(60.0, 200.0)
    return lambda rig: rig.inertia.append(lambda x: 130.0 * size * np.exp(-x / fade))


def _current(size: float, rng: np.random.Generator) -> Act:
    mean = rng.choice([-1.0, 1.0]) * 0.9 * size

    def act(rig: Rig) -> None:
        own = mean * rig.rng.normal(1.0, 0.08)
        tones = 2 * np.pi * rig.rng.uniform(0.05, 0.4, 5)
        phases = rig.rng.uniform(0, 2 * np.pi, 5)
        share = 0.18 * abs(mean) / np.sqrt(2.5)

        def flow(t: float, x: float) -> tuple[float, float]:
            shape = 1.0 + 0.1 * np.sin(2 * np.pi * x / 90.0)
            rate = float(np.sum(tones * np.cos(tones * t + phases)))
            return own * shape + share * float(np.sum(np.sin(tones * t + phases))), share * rate

        rig.flow.append(flow)

    return act


def _waves(size: float, rng: np.random.Generator) -> Act:
    omega, node = 2 * np.pi * rng.uniform(0.3, 1.0), rng.uniform(250.0, 400.0)

    def act(rig: Rig) -> None:
        phase, level = rig.rng.uniform(0, 2 * np.pi), size * rig.rng.normal(1.0, 0.05)

        def flow(t: float, x: float) -> tuple[float, float]:
            # a standing wave: strongest in the middle of the drop
            amplitude = 0.15 * omega * level * np.cos(np.pi * (x - 0.5 * TRAVEL) / node)
            angle = omega * t + phase
            return amplitude * np.sin(angle), amplitude * omega * np.cos(angle)

        rig.flow.append(flow)

    return act


def _tether(size: float, _: np.random.Generator) -> Act:
    return lambda rig: rig.forces.append(
        lambda _, x, v: -size * max(x, 0.0) / TRAVEL * (2800.0 + 2.0 * v * abs(v))
    )


def _wall(size: float, rng: np.random.Generator) -> Act:
    end = TRAVEL + rng.uniform(5.0, 9.0)
    return lambda rig: rig.factors.append(lambda x, _: 1.0 + 2.0 * size * (14.0 / (end - x)) ** 2)


def _camera_scale(size: float, rng: np.random.Generator) -> Act:
    scale, radius = 0.04 * size * rng.choice([-1.0, 1.0]), rng.uniform(2.0, 3.0)

    def act(rig: Rig) -> None:
        phase = rig.rng.uniform(0, 2 * np.pi)
        if rig.clicks:
            bent = lambda _, x: x * (1 + scale) + 0.04 * (np.sin(x / radius + phase) - np.sin(phase))  # noqa: E731
        else:
            bent = lambda _, x: x * (1 + scale) * (1 + 0.006 * ((x / TRAVEL - 0.5) ** 2 - 0.25))  # noqa: E731
        rig.seen.append(bent)

    return act


def _time_offset(size: float, rng: np.random.Generator) -> Act:
    late = 0.045 * size * rng.choice([-1.0, 1.0])

    def act(rig: Rig) -> None:
        rig.late += late * rig.rng.normal(1.0, 0.05)

    return act


def _clock_rate(size: float, rng: np.random.Generator) -> Act:
    """The stamps run fast or slow, by a fifth less while the clock warms up."""
    rate, warm = 0.015 * size * rng.choice([-1.0, 1.0]), rng.uniform(1.0, 4.0)

    def seen(t: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.interp(t - rate * (t - 0.2 * warm * -np.expm1(-t / warm)), t, x)

    return lambda rig: rig.seen.append(seen)


def _stribeck(size: float, rng: np.random.Generator) -> Act:
    """Friction that falls algebraically with speed."""
    level, slow = 900.0 * size, rng.uniform(3.0, 6.0)
    return lambda rig: rig.forces.append(
        lambda _, __, v: -level / (1.0 + (abs(v) / slow) ** 3) * np.tanh(v / 0.02)
    )


def _load_friction(size: float, _: np.random.Generator) -> Act:
    """A share of the string's tension, which is that of a weight that falls."""
    share = 0.04 * size

    def act(rig: Rig) -> None:
        rig.forces.append(lambda _, __, v: -share * rig.weight * GRAVITY * np.tanh(v / 0.02))
        rig.inertia.append(lambda _: -share * rig.weight)

    return act


def _marker_dropout(size: float, rng: np.random.Generator) -> Act:
    kind = rng.choice(["frozen", "jump", "bursts"])

    def act(rig: Rig) -> None:
        share, begin = 0.06 * size * rig.rng.uniform(0.5, 1.5), rig.rng.uniform(0.2, 0.6)
        far, hit = rig.rng.normal(0.0, 12.0), rig.rng.random(200) < min(0.05 * size, 0.4)
        heights = rig.rng.normal(0.0, 9.0, 200)

        def corrupt(t: np.ndarray, x: np.ndarray) -> np.ndarray:
            inside = (t > begin * t[-1]) & (t < (begin + min(share, 0.35)) * t[-1])
            if kind == "bursts":
                piece = np.minimum((200 * t / t[-1]).astype(int), 199)
                return np.where(hit[piece], x + heights[piece], x)
            held = x[np.searchsorted(t, begin * t[-1])] if kind == "frozen" else x + far
            return np.where(inside, held, x)

        rig.seen.append(corrupt)

    return act


def _wave_making(size: float, rng: np.random.Generator) -> Act:
    hump = rng.uniform(20.0, 28.0)
    return lambda rig: rig.factors.append(lambda _, v: 1.0 + 0.25 * size * np.exp(-(((v - hump) / 3.0) ** 2)))


def _string_slip(size: float, _: np.random.Generator) -> Act:
    def act(rig: Rig) -> None:
        at = np.sort(rig.rng.uniform(0.1, 0.95, 3)) * TRAVEL
        step = 0.5 * size * rig.rng.uniform(0.4, 1.6, 3)
        rig.seen.append(lambda _, x: x - np.sum(step / (1 + np.exp(-(x[:, None] - at) / 0.3)), axis=1))

    return act


def _friction_drift(size: float, _: np.random.Generator) -> Act:
    def act(rig: Rig) -> None:
        rig.friction *= 1.0 + 0.2 * size * (rig.order - 0.5)

    return act


def _stratification(size: float, rng: np.random.Generator) -> Act:
    layer, sign = rng.uniform(35.0, 75.0), rng.choice([-0.5, 1.0])
    return lambda rig: rig.factors.append(
        lambda x, _: 1.0 + 0.25 * sign * min(size, 3.0) / (1 + np.exp(-(x - layer) / 2.0))
    )


SIZES = [0.3, 1.0, 3.0]
EFFECTS: Catalogue = {
    "pulley-friction": (_pulley_friction, SIZES),
    "pulley-viscous": (_pulley_viscous, SIZES),
    "pulley-inertia": (_pulley_inertia, SIZES),
    "string-stretch": (_string_stretch, SIZES),
    "start-offset": (_start_offset, SIZES),
    "initial-speed": (_initial_speed, SIZES),
    "linear-drag": (_linear_drag, SIZES),
    "drag-reynolds": (_drag_reynolds, SIZES),
    "added-mass": (_added_mass, SIZES),
    "current": (_current, SIZES),
    "waves": (_waves, SIZES),
    "tether": (_tether, SIZES),
    "wall": (_wall, SIZES),
    "camera-scale": (_camera_scale, SIZES),
    "time-offset": (_time_offset, SIZES),
    "clock-rate": (_clock_rate, SIZES),
    "stribeck": (_stribeck, SIZES),
    "load-friction": (_load_friction, SIZES),
    "marker-dropout": (_marker_dropout, SIZES),
}
OUTSIDE: Catalogue = {
    "wave-making": (_wave_making, SIZES),
    "string-slip": (_string_slip, SIZES),
    "friction-drift": (_friction_drift, SIZES),
    "stratification": (_stratification, SIZES),
}
#: Attribute of a rig for each parameter that may change.
PARAMETERS = {"drag_coefficient": "drag", "added_mass": "added"}


def _changed(attribute: str) -> Callable[[float, np.random.Generator], Act]:
    """Return the maker of an act that changes an attribute of a rig by the share ``size``."""

    def maker(size: float, _: np.random.Generator) -> Act:
        return lambda rig: setattr(rig, attribute, getattr(rig, attribute) * (1.0 + size))

    return maker


CHANGES: Catalogue = {
    f"{PARAMETER}{name}": (_changed(attribute), []) for name, attribute in PARAMETERS.items()
}


def _of_odd_trial(attribute: str, factor: float, more: float = 0.0) -> Callable[..., Act]:
    """Return the maker of an act that changes an attribute of the rig in the odd trial only."""

    def act(rig: Rig) -> None:
        if rig.is_odd:
            setattr(rig, attribute, getattr(rig, attribute) * factor + more)

    return lambda _, __: act


#: What one trial has of its own: a pulling mass other than the one in the trials file, 10 mN more friction,
#: and a tenth more drag.
ODD_TRIALS: Catalogue = {
    f"{ODD}entry": (_of_odd_trial("weight", 1.25), []),
    f"{ODD}friction": (_of_odd_trial("friction", 1.0, 1000.0), []),
    f"{ODD}drag": (_of_odd_trial("drag", 1.1), []),
}
