"""Models and trials for tests of effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.blackbox.model import ArxModel
from swimid.effects.base import Effect
from swimid.fitting.drives import TailBeat
from swimid.fitting.model import Model, RigInput, SwimInput, Trial
from swimid.results import parameters
from swimid.rig import model as rig
from swimid.robots import file as robots
from swimid.robots.file import Robot
from swimid.swimmer.planar.model import MultilinkModel

INERTIA, FORCE = 1.25, 0.2
TIME = np.linspace(0.0, 4.0, 161)


def weight_trial(**known: Any) -> Trial:
    """Return a falling weight, measured as a steady run."""
    steady = RigInput(INERTIA, FORCE, pulley=True, release_s=0.0)
    return Trial("w", "fit", TIME, {"x_m": 0.2 * TIME}, rig=replace(steady, **known))


def weight_model(**values: float) -> rig.RigModel:
    """Return a falling weight without drag, added mass or friction, except for given values."""
    model = rig.falling_weight(mass_kg=INERTIA, force_N=FORCE, area_known=False, pulley=True)
    start = {"quadratic_drag": 0.0, "added_mass": 0.0, "pulley_friction": 0.0, **values}
    model.parameters = tuple(
        replace(p, start=start.get(p.name, p.start), free=p.free and p.name != "pulley_friction")
        for p in model.parameters
    )
    return model


def swimmer(name: str, **coefficients: float) -> MultilinkModel:
    """Return a built-in swimmer, with some coefficients changed."""
    return changed(robots.read(name), lambda robot: None, **coefficients)


def changed(robot: Robot, change: Callable[[Any], None], **coefficients: float) -> MultilinkModel:
    """Return a swimmer whose robot file a function has changed in place."""
    robot = robot.model_copy(deep=True)
    change(robot.multilink)
    model = MultilinkModel(robot)
    model.parameters = tuple(
        replace(p, start=coefficients.get(p.name, _value(robot, p.name, p.start))) for p in model.parameters
    )
    return model


def _value(robot: Robot, name: str, otherwise: float) -> float:
    assert robot.multilink is not None
    coefficient = robot.multilink.coefficients.get(name)
    return otherwise if coefficient is None else coefficient.value


def swim(
    model: MultilinkModel,
    *,
    frequency_hz: float = 1.2,
    amplitude_rad: float = 0.4,
    pose: tuple[float, float, float] = (0.3, -0.2, 0.7),
    duration_s: float = 3.0,
) -> Trial:
    """Return a beat from rest, with the simulation as measurement."""
    time = np.arange(0.0, duration_s, 0.025)
    beat = TailBeat("sine", frequency_hz, amplitude_rad)
    name = f"{frequency_hz} {amplitude_rad} {pose} {duration_s}"
    trial = Trial(name, "fit", time, {}, swim=SwimInput(beat, pose=pose))
    return replace(trial, measured=model.simulate(start(model), trial))


def start(model: Model, **values: float) -> np.ndarray:
    """Return start values, some replaced."""
    return np.array([values.get(p.name, p.start) for p in model.parameters])


def acted(model: Model, trial: Trial, effects: Sequence[tuple[Effect, Any]], **values: float) -> dict:
    """Simulate a model under effects with these parameter values."""
    affected = model.with_effects([effect for effect, _ in effects], [trial])
    own = np.concatenate([np.atleast_1d(np.asarray(v, dtype=float)) for _, v in effects])
    return affected.run(np.concatenate([start(model, **values), own]), trial)


def check_null(model: Model, trial: Trial, effect: Effect) -> None:
    """Check every variant: exact null, bounds, a change at each try."""
    values = start(model)
    plain = model.simulate(values, trial)
    variants = effect.variants(model, [trial])
    assert variants, f"{effect.name} does not apply"
    for variant in variants:
        own = variant.parameters(model, [trial])
        null = np.array([p.start for p in own])
        low, high = np.array([p.lower for p in own]), np.array([p.upper for p in own])
        assert np.all((low <= null) & (null <= high))
        assert all(p.scale > 0 and np.isfinite(p.scale) for p in own)
        affected = model.with_effects([variant], [trial])
        seen = affected.run(np.concatenate([values, null]), trial)
        hooked = model.simulate_hooked(values, trial, variant.hooks(null, trial, model))
        for name in plain:
            assert np.array_equal(plain[name], seen[name])
            np.testing.assert_allclose(hooked[name], plain[name], rtol=1e-9, atol=1e-9)
        tries = variant.tries(own)
        assert tries
        for point in tries:
            assert np.all((low <= point) & (point <= high))
        moved = affected.run(np.concatenate([values, tries[-1]]), trial)
        assert all(np.isfinite(moved[name]).all() for name in moved)
        assert any(np.abs(moved[name] - plain[name]).max() > 1e-7 for name in trial.measured)


def dry_fish() -> MultilinkModel:
    """Return the tendon fish without water."""
    names = ("c_ma", "c_Ia", "c_d0", "c_d13", "c_d4", "c_f0", "c_f13", "c_f4")
    return swimmer("tfish", **dict.fromkeys(names, 0.0))


def coasting(model: MultilinkModel) -> Trial:
    """Return a straight run without a beat."""
    return swim(model, amplitude_rad=0.0, pose=(0.0, 0.0, 0.0))


def arx_model(coefficients: dict[str, float], sample_time_s: float, *, output: str = "u_m_s") -> ArxModel:
    """Return the black-box model of some coefficients, from ``cmd1_rad`` to an output column."""
    estimates = {
        name: parameters.Estimate(value=value, unit="1", status="fixed")
        for name, value in coefficients.items()
    }
    return ArxModel(
        parameters.ParameterFile(
            model="arma",
            parameters=estimates,
            delay=1,
            sample_time_s=sample_time_s,
            settings={"input": "cmd1_rad", "output": output},
        )
    )
