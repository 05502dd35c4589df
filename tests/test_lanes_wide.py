"""Batches of runs with forces and elements of effects, against the scalar engine."""

from __future__ import annotations

import itertools
import platform
from dataclasses import replace

import numba
import numpy as np
import pytest

from swimid.diagnosis.remainder import FORCE_AXES, ResidualForce
from swimid.effects import catalogue
from swimid.effects.base import Effect
from swimid.fitting import drives
from swimid.fitting.model import TRACEABLE, Model, SwimInput, Trial
from swimid.robots import file as robot_format
from swimid.swimmer import lanes
from swimid.swimmer.planar.model import MultilinkModel
from tests import lanes_forms


def opened(name: str) -> MultilinkModel:
    """Return a robot with both kernels, not compiled."""
    catalogue.list_effects()
    model = MultilinkModel(robot_format.read(name))
    model.kernels.used = True
    return model


@pytest.fixture(scope="module")
def fish() -> MultilinkModel:
    """Return the tendon fish with compiled kernels."""
    model = opened("tfish")
    model.prepare(effects=True)
    return model


def given(model: MultilinkModel) -> np.ndarray:
    return np.array([model.get_file_values().get(p.name, p.start) for p in model.parameters])


def swims(model: MultilinkModel, duration_s: float) -> list[Trial]:
    """Return two trials off the origin and off the axes, whose data are simulated by the model."""
    plain = MultilinkModel(model.robot)
    found = []
    for k in range(2):
        swim = SwimInput(drives.TailBeat("sine", 1.0 + 0.2 * k, 0.3, 0.05 * k), pose=(0.3, -0.2 * k, 0.4 + k))
        trial = Trial(f"run{k}", "fit", np.arange(0.5, 0.5 + duration_s, 0.02), {}, swim=swim)
        found.append(replace(trial, measured=plain.simulate(given(plain), trial)))
    return found


def widened(model: MultilinkModel, own: list[Trial]) -> dict[str, Effect]:
    """Return every variant of every effect, and artificial forces, that need the wide kernel."""
    every = catalogue.applicable(catalogue.list_effects(), model, own)
    every += [ResidualForce(axis, 0.05, 0.3) for axis in FORCE_AXES]
    found = {}
    for effect in every:
        names = [p.name for p in effect.parameters(model, own)]
        hooks = effect.hooks(acting(model.with_effects([effect], own)), own[0], model)
        run = model.request(given(model), own[0], hooks)
        lane = model.kernels.choose(run, model.frame)
        if lane is None or lane[0] is model.kernels.wide:
            found[f"{effect.name} {names[0]}"] = effect
    return found


def acting(affected: Model) -> np.ndarray:
    """Return values of the parameters at which all effects act."""
    own = [p for acting in affected.acting for p in acting.parameters]
    return np.array([np.clip(p.start + 0.4 * p.scale, p.lower, p.upper) for p in own])


def compared(model: MultilinkModel, effects: list[Effect], own: list[Trial], count: int) -> None:
    """Compare channels, with a tolerance of one unit in the last place for each operation of a run."""
    plain = MultilinkModel(model.robot)
    one, many = (m.with_effects(effects, own) for m in (plain, model))
    values = np.concatenate([given(model), acting(one)])
    runs = [(values * (1.0 + 0.01 * k), own[k % 2]) for k in range(count)]
    assert model.kernels.wide is not None
    steps = (own[0].time_s[-1] - own[0].time_s[0]) / model.max_step
    operations = 4 * len(model.kernels.wide.equations.operations) * steps
    model.forget(own)
    for (point, trial), simulated in zip(runs, many.run_many(runs), strict=True):
        for channel, series in one.run(point, trial).items():
            far = operations * np.finfo(float).eps * np.max(np.abs(series))
            np.testing.assert_allclose(simulated[channel], series, rtol=0.0, atol=far, err_msg=channel)


@pytest.mark.slow
@pytest.mark.kernels
def test_every_force_and_element_agrees_with_the_engine(fish: MultilinkModel) -> None:
    own = swims(fish, 4.0)
    found = widened(fish, own)
    assert {name.split()[0] for name in found} >= {
        "com-offset", "fin-flexibility", "drag-reynolds", "lift-damping", "linear-drag", "wake-lift",
        "tether", "wall", "residual",
    }  # fmt: skip
    for effect in found.values():
        hooks = effect.hooks(acting(fish.with_effects([effect], own)), own[0], fish)
        assert fish.kernels.choose(fish.request(given(fish), own[0], hooks), fish.frame) is not None, effect
        compared(fish, [effect], own, 3)


@pytest.mark.kernels
def test_several_effects_agree_with_the_engine(fish: MultilinkModel) -> None:
    own = swims(fish, 4.0)
    found = widened(fish, own)
    for several in itertools.islice(itertools.combinations(found.values(), 3), 0, None, 23):
        compared(fish, list(several), own, 2)


@pytest.mark.kernels
def test_runs_of_one_batch_keep_their_own_effects(fish: MultilinkModel) -> None:
    """An effect may read coefficients from the tables. They differ from run to run, as in derivatives."""
    own = swims(fish, 0.6)
    for effect in widened(fish, own).values():
        affected = fish.with_effects([effect], own)
        values = [np.concatenate([share * given(fish), acting(affected)]) for share in (0.8, 1.0, 1.2)]
        alone = [fish.with_effects([effect], own).run_many([(one, own[0])])[0] for one in values]
        fish.forget(own)
        together = affected.run_many([(one, own[0]) for one in values])
        for first, second in zip(alone, together, strict=True):
            for name, column in first.items():
                np.testing.assert_array_equal(second[name], column, err_msg=effect.name)


def test_two_forces_of_one_kind_stay_on_the_engine(fish: MultilinkModel) -> None:
    own = swims(fish, 1.0)
    walls = [e for e in widened(fish, own).values() if e.name == "wall"][:2]
    hooks = fish.with_effects(walls, own).hooks(
        np.concatenate([given(fish), acting(fish.with_effects(walls, own))]), own[0]
    )
    assert len(hooks.force) == 2
    assert fish.kernels.choose(fish.request(given(fish), own[0], hooks), fish.frame) is None
    compared(fish, walls, own, 2)


@pytest.mark.slow
def test_forces_in_a_vertical_plane_agree_with_the_engine() -> None:
    """The generated module, run as Python, also has the effects of swimmers in a side view."""
    dolphin = opened("dolphin")
    assert dolphin.kernels.own is not None
    assert dolphin.kernels.wide is not None
    for kernel in (dolphin.kernels.own, dolphin.kernels.wide):
        kernel.module = lanes_forms.uncompiled(kernel)
    own = swims(dolphin, 0.06)
    found = widened(dolphin, own)
    assert {name.split()[0] for name in found} >= {"buoyancy", "surface-breach"}
    for effect in found.values():
        compared(dolphin, [effect], own, 1)


def test_every_traceable_force_can_be_traced() -> None:
    """The forces of all modules can be traced with unknown constants."""
    for known in TRACEABLE.values():
        tracer = lanes.Tracer()
        time = tracer.symbol("elapsed", 0)
        own, velocity = (
            lanes.array(tracer, "number", (known.constants,)),
            lanes.array(tracer, "state", (3,)),
        )
        pose = np.array([*velocity[:2], lanes.Angle(velocity[0], velocity[1])], dtype=object)
        wrench = np.zeros(3, dtype=object)
        lanes.on_symbols(known.function)(time, pose, velocity, own, wrench)
        assert any(isinstance(part, lanes.Symbol) for part in wrench)


@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="reads the assembly of one processor"
)
@pytest.mark.kernels
@pytest.mark.slow
def test_the_compiler_vectorises_the_wide_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    """The compiler vectorises the loop in spite of bit operations, exponentials and powers."""
    monkeypatch.setattr(numba.config, "BOUNDSCHECK", 0)
    kernel = opened("tfish").kernels.wide
    assert kernel is not None
    packed, single = lanes_forms.arithmetic(kernel)
    assert packed > 10 * max(single, 1)
