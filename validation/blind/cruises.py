"""Blind cruise tables of the boxfish, made without swimid.

Centimetres, grams, seconds. Every run is integrated from rest to the end of the distance, all runs at once,
by Kutta's third-order scheme; the thrust is constant within a run and takes its power from the recoil law at
terminal speed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.optimize import brentq, least_squares

from validation.blind import common
from validation.blind.common import Catalogue, stages_of, write_parameters

#: Height, length (cm); the last works like a smaller rectangle, unknown to the user.
FINS = {"2025Rect": (6.36, 3.18), "2925Rect": (7.65, 3.82), "3825Rect": (8.75, 4.37), "2925Arb": (7.0, 3.70)}
AXLE_GAP, AREA, DENSITY, MASS = 0.7, 69.8, 0.997, 1196.0
#: Speed at which effects on drag are sized, cm/s; largest f^2 theta I that was driven sizes loads.
TYPICAL = 8.0
#: Effects that the efficiency or the amplitude offset can imitate.
CONFOUNDED = ("servo-backlash", "amplitude-loss", "linear-drag", "camera-scale", "tether")

Array = np.ndarray


@dataclass
class Session:
    """All runs of a session; arrays over runs.

    ``amplitude`` (rad) and ``thrust`` turn the command into what the fin does and delivers.
    """

    fin: Array
    frequency: Array
    command: Array
    inertia: Array
    distance: float
    drag: float
    added: float
    efficiency: float
    offset: float
    rng: np.random.Generator
    order: Array = field(default_factory=lambda: np.zeros(0))
    amplitude: list[Callable[[Array], Array]] = field(default_factory=list)
    thrust: list[Callable[[Array], Array]] = field(default_factory=list)
    resistance: list[Callable[[Array, Array], Array]] = field(default_factory=list)
    water: float = 0.0
    swirl: float = 0.0
    watch: list[Callable[[Array], Array]] = field(default_factory=list)

    def times(self) -> Array:
        """Stop-watch times of all runs without reading error, s."""
        angle = self.command
        for change in self.amplitude:
            angle = change(angle)
        power = 8 * self.efficiency * np.pi**2 * self.inertia * self.frequency**3
        power = power * np.maximum(angle - self.offset, 1e-3) ** 2
        for change in self.thrust:
            power = power * change(angle)
        force = np.cbrt(power**2 * self.drag)
        mass = MASS + self.added

        def acceleration(x: Array, v: Array) -> Array:
            water = self.water + self.swirl * np.sin(2 * np.pi * x / 70.0)
            slip = v - water
            against = self.drag * slip * np.abs(slip)
            return (force - against - sum(r(x, slip) for r in self.resistance)) / mass

        h, x, v = 0.02, np.zeros(len(power)), np.zeros(len(power))
        arrival = np.full(len(power), np.nan)
        for step in range(15_000):
            a1 = acceleration(x, v)
            v2, x2 = v + 0.5 * h * a1, x + 0.5 * h * v
            a2 = acceleration(x2, v2)
            v3, x3 = v + h * (2 * a2 - a1), x + h * (2 * v2 - v)
            a3 = acceleration(x3, v3)
            ahead = x + h * (v + 4 * v2 + v3) / 6
            faster = v + h * (a1 + 4 * a2 + a3) / 6
            over = np.isnan(arrival) & (ahead >= self.distance)
            arrival[over] = step * h + h * (self.distance - x[over]) / (ahead[over] - x[over])
            x, v = ahead, faster
            if not np.isnan(arrival).any():
                break
        for change in self.watch:
            arrival = change(arrival)
        return arrival


Act = Callable[[Session], None]


def _backlash(size: float, rng: np.random.Generator) -> Act:
    half, soft = np.radians(1.2) * size, np.radians(rng.uniform(0.3, 0.8))
    # a compliant stop: large strokes lose the half play, small ones less
    return lambda s: s.amplitude.append(lambda a: a - half * a / np.hypot(a, soft + 0.5 * half))


def _loss(size: float, rng: np.random.Generator) -> Act:
    bend = rng.uniform(-0.2, 0.2)
    return lambda s: s.amplitude.append(lambda a: a * (1 - 0.08 * size * (1 + bend * (a / 0.28 - 1))))


def _lag(size: float, rng: np.random.Generator) -> Act:
    natural, damping = 9.0 / np.sqrt(size), rng.uniform(0.75, 1.0)

    def act(s: Session) -> None:
        r = s.frequency / natural
        s.amplitude.append(lambda a: a / np.hypot(1 - r**2, 2 * damping * r))

    return act


def _rate_limit(size: float, rng: np.random.Generator) -> Act:
    most, sharp = np.radians(400.0) / size**0.35, rng.uniform(4.0, 8.0)

    def act(s: Session) -> None:
        s.amplitude.append(lambda a: a / (1 + (2 * np.pi * s.frequency * a / most) ** sharp) ** (1 / sharp))

    return act


def _flexibility(size: float, rng: np.random.Generator) -> Act:
    power = rng.uniform(0.9, 1.4)

    def act(s: Session) -> None:
        def share(a: Array) -> Array:
            load = s.inertia * s.frequency**2 * a / (1000.0 * 12.25 * 0.28)
            return 1 / (1 + 0.2 * size * load**power)

        s.thrust.append(share)

    return act


def _linear_drag(size: float, rng: np.random.Generator) -> Act:
    power, level = rng.uniform(1.05, 1.3), 250.0 * size
    return lambda s: s.resistance.append(lambda _, v: level * np.sign(v) * (np.abs(v) / TYPICAL) ** power)


def _current(size: float, rng: np.random.Generator) -> Act:
    mean = 0.3 * size * rng.choice([-1.0, 1.0])

    def act(s: Session) -> None:
        s.water, s.swirl = mean, 0.15 * abs(mean)

    return act


def _tether(size: float, _: np.random.Generator) -> Act:
    return lambda s: s.resistance.append(lambda x, v: size * x / 115.0 * (220.0 + 1.2 * v * np.abs(v)))


def _scale(size: float, rng: np.random.Generator) -> Act:
    scale = 0.03 * size * rng.choice([-1.0, 1.0])
    return lambda s: s.watch.append(lambda t: t / (1 + scale))


def _reaction(size: float, rng: np.random.Generator) -> Act:
    late = 0.45 * size * rng.choice([-1.0, 1.0])
    return lambda s: s.watch.append(lambda t: t + late * (1 + 0.1 * s.rng.normal(size=len(t))))


def _droop(size: float, _: np.random.Generator) -> Act:
    """The battery gives less and less: the true frequency falls in the order of the runs."""

    def act(s: Session) -> None:
        s.thrust.append(lambda _: (1 - 0.05 * size * s.order**1.5) ** 3)

    return act


def _ventilation(size: float, rng: np.random.Generator) -> Act:
    """Air is drawn down to the fin when its tip goes fast."""
    onset = rng.uniform(26.0, 36.0)

    def act(s: Session) -> None:
        reach = np.array([FINS[f][1] for f in s.fin]) + AXLE_GAP

        def share(a: Array) -> Array:
            tip = 2 * np.pi * s.frequency * a * reach
            return 1 - min(0.3 * size, 0.8) / (1 + np.exp(-(tip - onset) / 2.0))

        s.thrust.append(share)

    return act


def _loose_fin(size: float, rng: np.random.Generator) -> Act:
    """One fin sits loose on its axle."""
    which = rng.choice(list(FINS)[:3])
    return lambda s: s.thrust.append(lambda _: np.where(s.fin == which, 1 - min(0.12 * size, 0.6), 1.0))


SIZES = [0.3, 1.0, 3.0]
CATALOGUE: dict[str, Catalogue] = {
    "cruise": {
        "servo-backlash": (_backlash, SIZES),
        "amplitude-loss": (_loss, SIZES),
        "servo-lag": (_lag, SIZES),
        "rate-limit": (_rate_limit, SIZES),
        "fin-flexibility": (_flexibility, SIZES),
        "linear-drag": (_linear_drag, SIZES),
        "current": (_current, SIZES),
        "tether": (_tether, SIZES),
        "camera-scale": (_scale, SIZES),
        "time-offset": (_reaction, SIZES),
    }
}
OUTSIDE: dict[str, Catalogue] = {
    "cruise": {
        "battery-droop": (_droop, SIZES),
        "ventilation": (_ventilation, SIZES),
        "loose-fin": (_loose_fin, SIZES),
    }
}


def plate_inertia(height: float, length: float) -> float:
    """Hydrodynamic inertia of a plate swung about an edge beyond a gap, g cm2."""
    return 9 * np.pi * DENSITY * height * ((length + AXLE_GAP) ** 4 - AXLE_GAP**4) / 128


def make_case(
    folder: Path,
    *,
    robot: str,
    effect: str | tuple[str, ...] | None,
    size: float,
    rng,
    more: tuple[Act, ...] = (),
) -> dict:
    """Write one blind cruise table (see :func:`validation.blind.rigs.make_case`)."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    names = () if effect is None else (effect,) if isinstance(effect, str) else tuple(effect)
    cd, added, efficiency = (v * rng.uniform(0.8, 1.25) for v in (0.705, 685.0, 0.341))
    offset = np.radians(rng.uniform(2.0, 6.5))
    fins = list(FINS)[: int(rng.integers(3, 5))]
    runs = [(f, hz, 16.0) for f in fins for hz in (1.5, 2.0, 2.5, 3.0, 3.5, 4.0)]
    runs += [(f, hz, a) for f in fins for hz in (2.5, 3.5) for a in (10.0, 12.0, 14.0, 18.0, 20.0)]
    fin = np.array([r[0] for r in runs])
    frequency, degrees = np.array([r[1] for r in runs]), np.array([r[2] for r in runs])
    inertia = np.array([plate_inertia(*FINS[f]) for f in fin])
    order = rng.permutation(len(runs)) / len(runs)
    known = {**CATALOGUE["cruise"], **OUTSIDE["cruise"]}
    acts = [known[name][0](size, rng) for name in names]
    seeds = rng.integers(0, 2**31, 3)
    spread, watch = rng.uniform(0.006, 0.012), rng.uniform(0.04, 0.1)

    def times(effects: tuple[Act, ...]) -> Array:
        session = Session(
            fin,
            frequency,
            np.radians(degrees),
            inertia,
            115.0,
            0.5 * DENSITY * cd * AREA,
            added,
            efficiency,
            offset,
            np.random.default_rng(seeds[0]),
            order,
        )
        for act in effects:
            act(session)
        return session.times()

    fair, plain = times((*acts, *more)), times(())
    chance = np.random.default_rng(seeds[1])
    per_fin = dict(zip(fins, chance.normal(1.0, 0.004, len(fins)), strict=True))
    read = fair * chance.normal(1.0, spread, len(fair)) * np.array([per_fin[f] for f in fin])
    read = np.round(read + chance.normal(0.0, watch, len(fair)), 2)
    rows = ["fin,frequency_hz,amplitude_deg,distance_m,time_s"]
    rows += [
        f"{f},{hz:g},{a:g},1.15,{t:.2f}"
        for f, hz, a, t in zip(fin, frequency, degrees, read, strict=True)
        if np.isfinite(t) and t > 0
    ]
    (folder / "speeds.csv").write_text("\n".join(rows) + "\n")
    (folder / "trials.yaml").write_text(
        "format: swimid-trials/1\nexperiment: cruise\nrobot: boxfish\ntable: speeds.csv\ndrag: drag.yaml\n"
    )
    drag_error = rng.uniform(0.03, 0.05, 2)
    measured = np.array([cd, added / 1000]) * (1 + drag_error * rng.normal(size=2))
    write_parameters(
        folder / "drag.yaml",
        "falling-weight",
        "boxfish",
        {
            "drag_coefficient": (measured[0], drag_error[0] * measured[0], "1", "estimated"),
            "added_mass": (measured[1], drag_error[1] * measured[1], "kg", "estimated"),
            "pulley_friction": (0.0308, 0.001, "N", "estimated"),
        },
    )
    truth = {"recoil_efficiency": efficiency, "amplitude_offset_deg": float(np.degrees(offset))}
    # in the tool's law it is the quotient of efficiency and drag that sets the speed
    effective = efficiency * measured[0] / cd
    prior = None
    if rng.random() < (0.85 if set(names) & set(CONFOUNDED) else 0.35):
        arbitrary = inertia[-1] if fins[-1] == "2925Arb" else None
        prior = _write_prior(folder, effective, truth["amplitude_offset_deg"], arbitrary, names, rng)
    speed, nominal = 115.0 / fair, 115.0 / plain
    sd = nominal * np.sqrt(spread**2 + 0.004**2 + (watch / plain) ** 2)
    raw = float(np.sqrt(np.nanmean(((speed - nominal) / sd) ** 2)))
    misfit, left, noncentrality = _refitted(
        fin, fins, frequency, np.radians(degrees), inertia, speed, sd, cd, added, efficiency, offset, prior
    )
    good, singles = np.isfinite(speed), {}

    def change_of(act: Act) -> list[Array]:
        """Return the change of the speeds by another act, in standard deviations of the noise."""
        change = ((115.0 / times((act,)) - nominal) / sd)[good]
        if not np.isfinite(change).all():
            raise FloatingPointError("a run does not arrive")
        return [change]

    if len(names) == 2:
        candidates = common.candidates(CATALOGUE["cruise"], dict(zip(names, acts, strict=True)), change_of)
        singles = _singles(misfit, ((speed - nominal) / sd)[good], candidates)
    channel = "mean_speed_m_s"
    motions = [rows[0]]
    motions += [
        f"{f},{hz:g},{a:g},1.15,{t:.8g}"
        for f, hz, a, t in zip(fin, frequency, degrees, fair, strict=True)
        if np.isfinite(t)
    ]
    # that of these very runs: a few fast ones have most of it
    floor = float(np.sqrt(np.nanmean((115.0 / read - speed) ** 2))) / 100
    return {
        "robot": "cruise",
        "effects": list(names),
        "stages": stages_of(names, OUTSIDE["cruise"]),
        "size": size,
        "prior": prior is not None,
        "truth": truth,
        "noise_sd": {channel: float(np.sqrt(np.mean(sd**2))) / 100},
        "floor": {channel: floor},
        "range": {channel: float(np.ptp(speed[np.isfinite(speed)])) / 100},
        "gap_over_floor": {channel: raw, "overall": raw},
        "gap_refit": {channel: left, "overall": left},
        "noncentrality": noncentrality,
        "singles": singles,
        "noise_free": {"speeds.csv": "\n".join(motions) + "\n"},
        "arrays": {f"runs/{channel}": speed / 100, f"runs/{channel}_nominal": nominal / 100},
    }


def _write_prior(
    folder: Path,
    efficiency: float,
    offset_deg: float,
    arbitrary: float | None,
    names: tuple[str, ...],
    rng: np.random.Generator,
) -> tuple[float, bool]:
    """A calibration of another day; relative error of the efficiency, and whether the offset is known."""
    error, known = rng.uniform(0.02, 0.04), "servo-backlash" in names or bool(rng.random() < 0.3)
    value = efficiency * (1 + error * rng.normal())
    angle_sd = 0.1 if known else rng.uniform(0.1, 0.25)
    angle = offset_deg + (0.0 if known else angle_sd) * rng.normal()
    rows = {
        "recoil_efficiency": (value, error * value, "1", "estimated"),
        "amplitude_offset_deg": (angle, angle_sd, "deg", "fixed" if known else "estimated"),
    }
    if arbitrary is not None:
        own = arbitrary * 1e-7 * efficiency / value
        rows["inertia_2925Arb"] = (own, 0.03 * own, "kg m^2", "estimated")
    write_parameters(folder / "params_prior.yaml", "propulsion", "boxfish", rows)
    return error, known


def _refitted(fin, fins, frequency, command, inertia, speed, sd, cd, added, efficiency, offset, prior):
    """Return the residual function of a refit of efficiency and offset, and the gap that its optimum leaves.

    The gap is a root mean square over the noise, and the noncentrality.
    """
    drag, mass = 0.5 * DENSITY * cd * AREA, MASS + added
    kappa = drag / mass * 115.0
    # mean over terminal speed of a run from rest: cosh(v_end * t * drag / mass) = exp(kappa)
    phase = brentq(lambda y: np.logaddexp(y, -y) - np.log(2.0) - kappa, 0.0, kappa + 2.0)
    ratio = kappa / phase
    good = np.isfinite(speed)
    arbitrary = fin == "2925Arb"

    def misfit(p: Array) -> Array:
        angle = np.maximum(command - offset * p[1], 1e-3)
        power = 8 * np.pi**2 * efficiency * p[0] * np.where(arbitrary, p[2], 1.0) * inertia
        terminal = np.cbrt(power * frequency**3 * angle**2 / drag)
        return ((ratio * terminal - speed) / sd)[good]

    def residual(p: Array) -> Array:
        if prior is None:
            return misfit(p)
        scales = [prior[0], 0.001 if prior[1] else np.radians(0.2) / offset, 0.03]
        return np.concatenate([misfit(p), (p - 1) / scales])

    best = least_squares(residual, np.ones(3), bounds=([0.1, -2.0, 0.1], [5.0, 5.0, 5.0])).x
    return residual, float(np.sqrt(np.mean(misfit(best) ** 2))), float(np.sum(residual(best) ** 2))


def _singles(residual: Callable[[Array], Array], change: Array, candidates: dict) -> dict[str, float]:
    """Return the noncentrality that a refit with each single effect leaves of a change, to first order."""
    base = residual(np.ones(3))
    system = np.stack([(residual(1 + 0.01 * one) - base) / 0.01 for one in np.eye(3)], axis=1)
    # without data of the arbitrary fin, its factor is unknown
    system = system[:, np.any(system != 0, axis=0)]
    extra = len(base) - len(change)

    def padded(values: Array) -> Array:
        return np.concatenate([values, np.zeros(extra)])

    columns = {name: np.stack([padded(d[0]) for d in draws], axis=1) for name, draws in candidates.items()}
    return common.left_by_each(system, padded(change), columns)
