"""Blind cases of free roll decays, made without swimid: SI units, adaptive Dormand-Prince 8(5,3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from tests.blind.common import Catalogue, left_by_refit, stages_of, write_parameters

DURATION = 6.0


@dataclass
class Decay:
    """One trial: moments (N m) on a body of given inertia (kg m2), angles in rad."""

    inertia: float
    stiffness: float
    quadratic: float
    linear: float
    start: float
    rng: np.random.Generator
    moments: list[Callable[[float, float, float], float]] = field(default_factory=list)

    def swing(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (s) and roll angle (rad), every two milliseconds."""

        def rate(t: float, s: np.ndarray) -> list[float]:
            moment = -self.stiffness * s[0] - self.linear * s[1] - self.quadratic * s[1] * abs(s[1])
            return [s[1], (moment + sum(m(t, s[0], s[1]) for m in self.moments)) / self.inertia]

        t = np.arange(0.0, DURATION, 2e-3)
        run = solve_ivp(
            rate,
            (0.0, DURATION),
            [self.start, 0.0],
            method="DOP853",
            rtol=1e-6,
            atol=1e-7,
            t_eval=t,
            max_step=0.2,
        )
        return t, run.y[0]


Act = Callable[[Decay], None]


def _dry(size: float, rng: np.random.Generator) -> Act:
    rise, slow = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.3)

    def act(decay: Decay) -> None:
        level = np.radians(0.15) * size * decay.stiffness
        decay.moments.append(
            lambda _, __, w: -level * (1 + rise * np.exp(-((abs(w) / slow) ** 1.5))) * np.tanh(w / 0.01)
        )

    return act


def _viscous(size: float, rng: np.random.Generator) -> Act:
    power = rng.uniform(1.05, 1.25)

    def act(decay: Decay) -> None:
        critical = 2 * np.sqrt(decay.stiffness * decay.inertia)
        decay.moments.append(lambda _, __, w: -0.012 * size * critical * np.sign(w) * abs(w) ** power)

    return act


def _waves(size: float, rng: np.random.Generator) -> Act:
    omega = 2 * np.pi * rng.uniform(0.3, 0.8)

    def act(decay: Decay) -> None:
        phase, slope = decay.rng.uniform(0, 2 * np.pi), np.radians(0.7) * size * decay.rng.normal(1.0, 0.1)
        decay.moments.append(lambda t, _, __: decay.stiffness * slope * np.sin(omega * t + phase))

    return act


def _hardening(size: float, rng: np.random.Generator) -> Act:
    """A moment with the hyperbolic sine of the angle, or with the sine of a multiple of it."""
    soft = rng.random() < 0.4
    bend = np.sqrt(6.0 * 0.2 * min(size, 2.0 if soft else 3.0)) / np.radians(20.0)

    def act(decay: Decay) -> None:
        law = np.sin if soft else np.sinh
        decay.moments.append(lambda _, angle, __: -decay.stiffness * (law(bend * angle) / bend - angle))

    return act


def _stribeck(size: float, rng: np.random.Generator) -> Act:
    """Friction that falls algebraically with the rate."""
    slow = rng.uniform(0.15, 0.4)

    def act(decay: Decay) -> None:
        level = np.radians(0.4) * size * decay.stiffness
        decay.moments.append(lambda _, __, w: -level / (1.0 + (abs(w) / slow) ** 3) * np.tanh(w / 0.01))

    return act


def _loose_ballast(size: float, _: np.random.Generator) -> Act:
    """Something inside rolls over to the other side: a moment that lags the angle by a fixed width."""

    def act(decay: Decay) -> None:
        side = [1.0]

        def moment(_: float, angle: float, __: float) -> float:
            if angle * side[0] < -np.radians(3.0):
                side[0] = -side[0]
            return decay.stiffness * np.radians(0.25) * size * side[0]

        decay.moments.append(moment)

    return act


SIZES = [0.3, 1.0, 3.0]
EFFECTS: Catalogue = {
    "pulley-friction": (_dry, SIZES),
    "linear-drag": (_viscous, SIZES),
    "waves": (_waves, SIZES),
    "hardening": (_hardening, SIZES),
    "stribeck": (_stribeck, SIZES),
}
OUTSIDE: Catalogue = {"loose-ballast": (_loose_ballast, SIZES)}


def make_case(folder: Path, names: tuple[str, ...], size: float, rng: np.random.Generator) -> dict:
    """Write one blind roll decay (see :func:`tests.blind.rigs.make_case`)."""
    folder.mkdir(parents=True, exist_ok=True)
    body, added = rng.uniform(0.001, 0.003), rng.uniform(0.2, 0.5)
    stiffness = body * (2 * np.pi * rng.uniform(0.9, 1.6)) ** 2
    critical = 2 * np.sqrt(stiffness * body * (1 + added))
    linear, quadratic = critical * rng.uniform(0.01, 0.02), critical * rng.uniform(0.01, 0.03)
    known = {**EFFECTS, **OUTSIDE}
    acts = [known[name][0](size, rng) for name in names]
    count, noise, rate = int(rng.integers(6, 9)), np.radians(rng.uniform(0.15, 0.4)), rng.uniform(40.0, 80.0)
    starts = np.radians(rng.uniform(8.0, 25.0, count)) * rng.choice([-1.0, 1.0], count)
    seeds = rng.integers(0, 2**31, (count, 3))

    def decay(k: int, *, effects: bool, scatter: bool) -> Decay:
        own = Decay(
            body * (1 + added), stiffness, quadratic, linear, starts[k], np.random.default_rng(seeds[k, 0])
        )
        if scatter:
            chance = np.random.default_rng(seeds[k, 1])
            own.quadratic *= chance.normal(1.0, 0.02)
            own.linear *= chance.normal(1.0, 0.02)
            own.stiffness *= chance.normal(1.0, 0.001)
        for act in acts if effects else ():
            act(own)
        return own

    arrays: dict[str, np.ndarray] = {}
    raw, drawn, changes, frames_of = [], [], [], []
    lines = ["format: swimid-trials/1", "experiment: free-decay", "robot: hull.yaml", "trials:"]
    held = rng.choice(count, 1) if rng.random() < 0.4 else []
    for k in range(count):
        t, roll = decay(k, effects=True, scatter=True).swing()
        chance = np.random.default_rng(seeds[k, 2])
        frames = np.arange(0.0, t[-1], 1.0 / rate)
        noisy = chance.normal(0.0, noise, len(frames))
        read = np.interp(frames, t, roll) + noisy
        name = f"roll{k + 1:02d}"
        rows = "\n".join(f"{a:.6f},{b:.6f}" for a, b in zip(frames, read, strict=True))
        (folder / f"{name}.csv").write_text(f"t_s,roll_rad\n{rows}\n")
        lines.append(f"  - {{log: {name}.csv, id: {name}{', role: validate' if k in held else ''}}}")
        fair, plain, moved = (
            np.interp(frames, *decay(k, effects=e, scatter=s).swing())
            for e, s in ((True, False), (False, False), (False, True))
        )
        raw.append((fair - plain) ** 2)
        changes.append(fair - plain)
        frames_of.append(frames)
        # the noise of these very samples, and what scatter does there: of trials that errors are of
        if k in held or not len(held):
            drawn.append(noisy**2 + (moved - plain) ** 2)
        arrays |= {f"{name}/t_s": frames, f"{name}/roll_rad": fair, f"{name}/roll_rad_nominal": plain}
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
    (folder / "hull.yaml").write_text(
        "format: swimid-robot/1\nname: hull\n"
        f"body: {{inertial_mass_kg: 1.2, roll_inertia_kg_m2: {body:.6g}}}\n"
        f"rig: {{roll_stiffness_N_m_rad: {stiffness:.6g}}}\n"
    )
    prior = rng.random() < (0.85 if "linear-drag" in names else 0.35)
    if prior:
        _write_prior(folder, body * added, quadratic, linear, stiffness, rng)
    floor = float(np.sqrt(np.mean(np.concatenate(drawn))))
    gap = float(np.sqrt(np.mean(np.concatenate(raw)))) / floor
    left, noncentrality = _refitted(decay, frames_of, changes, noise, 0.035 if prior else 0.6)
    return {
        "robot": "free-decay",
        "effects": list(names),
        "stages": stages_of(names, OUTSIDE),
        "size": size,
        "prior": bool(prior),
        "noise_sd": {"roll_rad": float(noise)},
        "floor": {"roll_rad": floor},
        "range": {"roll_rad": float(2 * np.max(np.abs(starts)))},
        "gap_over_floor": {"roll_rad": gap, "overall": gap},
        "gap_refit": {"roll_rad": left / noise, "overall": left / noise},
        "noncentrality": noncentrality,
        "arrays": arrays,
    }


def _refitted(
    decay: Callable[..., Decay],
    frames: list[np.ndarray],
    changes: list[np.ndarray],
    noise: float,
    known: float,
) -> tuple[float, float]:
    """`left_by_refit` with inertia and damping free within ``known`` (relative), and each trial's start."""
    shared, own = [], []
    for k, t in enumerate(frames):

        def roll(k: int = k, t: np.ndarray = t, **changed: float) -> np.ndarray:
            trial = decay(k, effects=False, scatter=False)
            for name, factor in changed.items():
                setattr(trial, name, getattr(trial, name) * factor)
            return np.interp(t, *trial.swing())

        base = roll()
        # the known body is three quarters of the inertia that is estimated
        steps = {"inertia": 0.25 * known, "quadratic": known, "linear": known}
        slopes = {name: (roll(**{name: 1.01}) - base) / 0.01 for name in (*steps, "stiffness", "start")}
        shared.append(np.stack([slopes[name] * sd for name, sd in steps.items()], axis=1))
        chance = [slopes["quadratic"] * 0.02, slopes["linear"] * 0.02, slopes["stiffness"] * 0.001]
        own.append(np.stack([*chance, slopes["start"], np.gradient(base, t)], axis=1))
    return left_by_refit(changes, shared, own, [np.full(len(t), noise) for t in frames])


def _write_prior(
    folder: Path,
    added: float,
    quadratic: float,
    linear: float,
    stiffness: float,
    rng: np.random.Generator,
) -> None:
    rows = {}
    for name, truth, unit, status in (
        ("added_inertia", added, "kg m^2", "estimated"),
        ("quadratic_damping", quadratic, "N m s^2/rad^2", "estimated"),
        ("linear_damping", linear, "N m s/rad", "estimated"),
        ("stiffness", stiffness, "N m/rad", "fixed"),
    ):
        error = 0.0 if status == "fixed" else rng.uniform(0.02, 0.05)
        value = truth * (1 + error * rng.normal())
        rows[name] = (value, error * value, unit, status)
    write_parameters(folder / "params_prior.yaml", model="free-decay", robot="hull.yaml", parameters=rows)
