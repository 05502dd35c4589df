"""Blind cases of free roll decays, made without swimid: SI units, adaptive Dormand-Prince 8(5,3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from validation.blind import common
from validation.blind.common import PARAMETER, Catalogue, left_by_refit, stages_of, write_parameters

DURATION = 6.0
#: Parameters that may change between the fit of the parameter file and the trials, with their units.
PARAMETERS = {"added_inertia": "kg m^2", "quadratic_damping": "N m s^2/rad^2", "linear_damping": "N m s/rad"}
#: Relative prior standard deviation of each coefficient in a fit.
PRIOR = 0.6


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


def _changed(parameter: str, factor: float, body: float) -> Act:
    """Return an act that multiplies a parameter. The inertia ``body`` (kg m2) without water stays."""

    def act(decay: Decay) -> None:
        if parameter == "added_inertia":
            decay.inertia = body + factor * (decay.inertia - body)
        else:
            attribute = parameter.removesuffix("_damping")
            setattr(decay, attribute, factor * getattr(decay, attribute))

    return act


def make_case(folder: Path, names: tuple[str, ...], size: float, rng: np.random.Generator) -> dict:
    """Write one blind roll decay (see :func:`validation.blind.rigs.make_case`)."""
    folder.mkdir(parents=True, exist_ok=True)
    body, added = rng.uniform(0.001, 0.003), rng.uniform(0.2, 0.5)
    stiffness = body * (2 * np.pi * rng.uniform(0.9, 1.6)) ** 2
    critical = 2 * np.sqrt(stiffness * body * (1 + added))
    linear, quadratic = critical * rng.uniform(0.01, 0.02), critical * rng.uniform(0.01, 0.03)
    known = {**EFFECTS, **OUTSIDE}
    changed = [name.removeprefix(PARAMETER) for name in names if name.startswith(PARAMETER)]
    acts = [known[name][0](size, rng) for name in names if name in known]
    acts += [_changed(name, 1.0 + size, body) for name in changed]
    count, noise, rate = int(rng.integers(6, 9)), np.radians(rng.uniform(0.15, 0.4)), rng.uniform(40.0, 80.0)
    starts = np.radians(rng.uniform(8.0, 25.0, count)) * rng.choice([-1.0, 1.0], count)
    seeds = rng.integers(0, 2**31, (count, 3))

    def decay(k: int, *, effects: Sequence[Act], scatter: bool) -> Decay:
        own = Decay(
            body * (1 + added), stiffness, quadratic, linear, starts[k], np.random.default_rng(seeds[k, 0])
        )
        if scatter:
            chance = np.random.default_rng(seeds[k, 1])
            own.quadratic *= chance.normal(1.0, 0.02)
            own.linear *= chance.normal(1.0, 0.02)
            own.stiffness *= chance.normal(1.0, 0.001)
        for act in effects:
            act(own)
        return own

    arrays: dict[str, np.ndarray] = {}
    raw, drawn, changes, frames_of, noise_free = [], [], [], [], {}
    lines = ["format: swimid-trials/1", "experiment: free-decay", "robot: hull.yaml", "trials:"]
    held = rng.choice(count, 1) if rng.random() < 0.4 else []
    for k in range(count):
        t, roll = decay(k, effects=acts, scatter=True).swing()
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
            for e, s in ((acts, False), ((), False), ((), True))
        )
        raw.append((fair - plain) ** 2)
        changes.append(fair - plain)
        frames_of.append(frames)
        noise_free[f"{name}.csv"] = common.log_text(t_s=frames, roll_rad=fair)
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
    truth = np.array([body * added, quadratic, linear])
    plain_decays = [decay(k, effects=(), scatter=False) for k in range(count)]
    # only the inertia of the water is estimated
    scale = np.array([added / (1 + added), 1.0, 1.0])
    if changed:
        prior, known_to = True, _write_fit(folder, plain_decays, scale, truth, noise, rate, rng)
    else:
        prior = rng.random() < (0.85 if "linear-drag" in names else 0.35)
        known_to = np.diag(np.full(3, 0.035 if prior else PRIOR))
    if prior and not changed:
        _write_prior(folder, body * added, quadratic, linear, stiffness, rng)
    floor = float(np.sqrt(np.mean(np.concatenate(drawn))))
    gap = float(np.sqrt(np.mean(np.concatenate(raw)))) / floor

    def change_of(act: Act) -> list[np.ndarray]:
        """Return the change of each trial by another act, in rad."""
        return [
            np.interp(t, *decay(k, effects=[act], scatter=False).swing())
            - np.interp(t, *plain_decays[k].swing())
            for k, t in enumerate(frames_of)
        ]

    candidates = {}
    if len(names) == 2:
        candidates = common.candidates(EFFECTS, dict(zip(names, acts, strict=True)), change_of)
    shared, own = _columns(plain_decays, frames_of)
    if changed:
        candidates = common.alone(PARAMETERS, shared, names)
    shared = [slopes * scale @ known_to for slopes in shared]
    sds = [np.full(len(t), noise) for t in frames_of]
    left, noncentrality, singles = left_by_refit(changes, shared, own, sds, candidates)
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
        "singles": singles,
        "truth": dict(zip(PARAMETERS, truth, strict=True)),
        "factors": dict.fromkeys(changed, 1.0 + size),
        "arrays": arrays,
        "noise_free": noise_free,
    }


def _columns(decays: Sequence[Decay], frames: Sequence[np.ndarray]) -> tuple[list, list]:
    """Return the changes of each trial (rad) by the coefficients, and by what scatters between trials.

    A change by inertia, quadratic or linear damping is for twice its value, to first order. The start of each
    trial is free.
    """
    shared, own = [], []
    for trial, t in zip(decays, frames, strict=True):
        base = np.interp(t, *trial.swing())
        slopes = {}
        for name in ("inertia", "quadratic", "linear", "stiffness", "start"):
            moved = replace(trial, **{name: 1.01 * getattr(trial, name)})
            slopes[name] = (np.interp(t, *moved.swing()) - base) / 0.01
        shared.append(np.stack([slopes[name] for name in ("inertia", "quadratic", "linear")], axis=1))
        chance = [slopes["quadratic"] * 0.02, slopes["linear"] * 0.02, slopes["stiffness"] * 0.001]
        own.append(np.stack([*chance, slopes["start"], np.gradient(base, t)], axis=1))
    return shared, own


def _write_fit(
    folder: Path,
    decays: Sequence[Decay],
    scale: np.ndarray,
    truth: np.ndarray,
    noise: float,
    rate: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Write the estimates of a fit to the decays of another day, and return the root of their covariance.

    Parameters
    ----------
    decays : sequence of Decay
        Trials like those of the other day, which begin at other angles.
    scale : ndarray, shape (3,)
        Relative change of inertia and dampings for a relative change of each parameter.
    truth : ndarray, shape (3,)
    noise, rate : float
        Standard deviation of the noise (rad), and frames in a second.

    Returns
    -------
    ndarray, shape (3, 3)
        Square root of the covariance of the relative errors.
    """
    starts = np.radians(rng.uniform(8.0, 25.0, len(decays)))
    others = [replace(one, start=start) for one, start in zip(decays, starts, strict=True)]
    frames = [np.arange(0.0, DURATION - 2e-3, 1.0 / rate) for _ in others]
    shared, own = _columns(others, frames)
    system = common.stacked(
        [PRIOR * slopes * scale for slopes in shared], own, [np.full(len(t), noise) for t in frames]
    )
    covariance = PRIOR**2 * common.fit_covariance(system, 3)
    estimates, stderr, correlation = common.draw_fit(truth, covariance, 3.0 * truth, rng)
    rows = {}
    for k, (name, unit) in enumerate(PARAMETERS.items()):
        rows[name] = (estimates[k], stderr[k], unit, "estimated")
    rows["stiffness"] = (others[0].stiffness, 0.0, "N m/rad", "fixed")
    write_parameters(folder / "params_prior.yaml", "free-decay", "hull.yaml", rows, correlation)
    return np.linalg.cholesky(covariance)


def _write_prior(
    folder: Path, added: float, quadratic: float, linear: float, stiffness: float, rng: np.random.Generator
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
    write_parameters(folder / "params_prior.yaml", "free-decay", "hull.yaml", rows)
