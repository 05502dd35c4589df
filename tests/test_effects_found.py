"""An effect is found alone, with its size, in trials of other code and of another form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

import swimid
from swimid.diagnosis.evidence import Diagnosis
from tests.generators import gap_trials
from validation.blind import rigs, swim_body, swimmers
from validation.blind.swim_case import Act


def found(
    folder: Path, effect: str, params: str = "params.yaml", answer: str = "explained"
) -> dict[str, tuple[float, float]]:
    """Return value and standard error of the parameters of an effect that is tried alone and is the cause."""
    gap = swimid.diagnose(folder / "trials.yaml", params=folder / params, effects=[effect])
    assert isinstance(gap, Diagnosis)
    assert gap.answer == answer, gap.summary()
    assert set(gap.causes["effect"]) == {effect}
    return {row["parameter"]: (row["value"], row["stderr"]) for _, row in gap.causes.iterrows()}


def rig(
    folder: Path, robot: str, effect: str, size: float, seed: int, answer: str = "explained"
) -> dict[str, tuple[float, float]]:
    """Return the same for a blind case with a calibration of another day."""
    label = rigs.make_case(folder, robot=robot, effect=effect, size=size, rng=np.random.default_rng(seed))
    assert label["prior"]
    return found(folder, effect, "params_prior.yaml", answer)


@pytest.mark.slow
@pytest.mark.parametrize("size, seed", [(1.0, 5), (3.0, 6)])
def test_friction_of_a_pulley_that_falls_with_speed(tmp_path: Path, size: float, seed: int) -> None:
    """The true friction falls algebraically, the fitted one as a Gaussian: a tenth is allowed."""
    cause = rig(tmp_path, "falling-weight", "stribeck", size, seed)
    assert cause["rise_N"][0] == pytest.approx(900.0e-5 * size, rel=0.1)
    assert 0.03 <= cause["stribeck_m_s"][0] <= 0.09


@pytest.mark.slow
def test_friction_of_a_pulley_under_load(tmp_path: Path) -> None:
    # drag and added mass imitate it; only their calibration of another day shows the difference
    cause = rig(tmp_path, "falling-weight", "load-friction", 3.0, 6, answer="ambiguous")
    value, stderr = cause["share"]
    assert value == pytest.approx(0.12, abs=3 * stderr)
    assert stderr < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("size, seed", [(1.0, 5), (3.0, 6)])
def test_a_moment_that_is_not_proportional_to_the_roll(tmp_path: Path, size: float, seed: int) -> None:
    """The true moments are a sine and a hyperbolic sine, the fitted ones cubic: 15 % are allowed."""
    value, _ = rig(tmp_path, "free-decay", "hardening", size, seed)["hardening_rad_2"]
    assert abs(value) == pytest.approx(0.2 * size / np.radians(20.0) ** 2, rel=0.15)


@pytest.mark.slow
def test_friction_of_a_bearing_that_falls_with_speed(tmp_path: Path) -> None:
    """The true friction has a tail at twice the Stribeck speed, where a Gaussian is nearly zero."""
    cause = rig(tmp_path, "free-decay", "stribeck", 3.0, 6)
    hull = yaml.safe_load((tmp_path / "hull.yaml").read_text())
    rise = np.radians(0.4) * 3.0 * hull["rig"]["roll_stiffness_N_m_rad"]
    assert cause["rise_N_m"][0] == pytest.approx(rise, rel=0.25)
    assert 0.15 <= cause["stribeck_rad_s"][0] <= 0.5


def clock(act: Act) -> dict[str, tuple[float, float]]:
    """Return an error of the clock over 10 s, whose rate falls slightly as it warms up."""
    assert act.clock is not None
    trial = gap_trials.plan("tfish", gap_trials.SETTINGS, 10.0, 25.0, 1)[0]
    return {"rate": (float(10.0 - act.clock(trial, np.array([10.0]))[0]) / 10.0, 0.1)}


def lift(act: Act) -> dict[str, tuple[float, float]]:
    """Return the lift as a share of the published drag across the links."""
    return {"lift_N_s2_m2": (act.facts["slope"] * float(swim_body.of("tfish", {}).across.sum()), 0.25)}


#: Hidden sizes, and relative errors allowed for the other form.
HIDDEN: dict[str, Callable[[Act], dict[str, tuple[float, float]]]] = {
    "clock-rate": clock,
    "hardening": lambda act: {"hardening_rad_2": (act.facts["hardening_rad_2"], 0.3)},
    "slip": lambda act: {"loss": (act.facts["loss"], 0.1), "begin_s": (10.0 * act.facts["share"], 0.05)},
    "stribeck": lambda act: {
        "stick_rad": (act.facts["stick_rad"], 0.25),
        # the friction of the generator has a longer tail than a Gaussian, so that the rate has the same order
        # only
        "stribeck_rad_s": (act.facts["slow"], 0.6),
    },
    # the torques of the generator follow from the published coefficients too
    "load-friction": lambda act: {"held_rad_N_m": (act.facts["held_rad_N_m"], 0.35)},
    "lift-damping": lift,
}


@pytest.mark.slow
@pytest.mark.parametrize("effect", HIDDEN)
def test_an_effect_of_a_tendon_fish(tmp_path: Path, effect: str) -> None:
    act = swimmers.CATALOGUE["tfish"][effect].make(np.random.default_rng(5), 1.0, "tfish")
    gap_trials.write(tmp_path, "tfish", [act])
    cause = found(tmp_path, effect)
    for name, (size, error) in HIDDEN[effect](act).items():
        assert cause[name][0] == pytest.approx(size, rel=error), name
