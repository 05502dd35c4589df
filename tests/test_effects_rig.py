"""Effects of the test rig, and the kernel of the rig with forces and moving water, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from swimid.effects.base import Effect
from swimid.effects.rig import (
    InitialSpeed,
    PulleyFriction,
    PulleyInertia,
    PulleyViscous,
    StartOffset,
    StringStretch,
    solve_oscillation,
)
from swimid.fitting.model import ExternalForce, Hooks, RigInput, Trial, no_force
from swimid.propulsion.model import RecoilModel
from swimid.rig import model as rig
from tests.effect_cases import FORCE, INERTIA, TIME, acted, check_null, start, weight_model, weight_trial

ALL = [InitialSpeed(), PulleyFriction(), PulleyInertia(), PulleyViscous(), StartOffset(), StringStretch()]


def _still(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((len(time_s), 2)), np.zeros((len(time_s), 2))


@pytest.mark.parametrize("effect", ALL, ids=lambda e: e.name)
def test_null_and_tries(effect: Effect) -> None:
    check_null(weight_model(quadratic_drag=2.0, added_mass=0.4), weight_trial(), effect)


@pytest.mark.parametrize("effect", ALL, ids=lambda e: e.name)
def test_rig_effects_leave_other_models_alone(effect: Effect) -> None:
    cruise = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4})
    assert not effect.variants(cruise, [])


def test_what_the_model_estimates_itself_is_no_effect() -> None:
    model = rig.falling_weight(mass_kg=1.0, force_N=0.2, area_known=False, pulley=True)
    assert not PulleyFriction().variants(model, [weight_trial()])
    assert PulleyViscous().variants(model, [weight_trial()])
    assert not PulleyViscous().variants(model, [weight_trial(pulley=False)])
    decay = rig.free_decay("roll_rad", inertia=0.01, stiffness=1.0, guess=1.0, amplitude=0.3)
    assert not StartOffset().variants(decay, [])
    assert PulleyFriction().variants(decay, [])


def test_friction_reduces_the_force() -> None:
    seen = acted(weight_model(), weight_trial(), [(PulleyFriction(), 0.05)])
    np.testing.assert_allclose(seen["x_m"], 0.5 * (FORCE - 0.05) / INERTIA * TIME**2, atol=1e-12)


def test_friction_of_a_slide_where_no_trial_has_a_pulley() -> None:
    trial = weight_trial(pulley=False)
    (slide,) = PulleyFriction().variants(weight_model(), [trial])
    seen = acted(weight_model(), trial, [(slide, 0.05)])
    np.testing.assert_allclose(seen["x_m"], 0.5 * (FORCE - 0.05) / INERTIA * TIME**2, atol=1e-12)
    (pulley,) = PulleyFriction().variants(weight_model(), [trial, weight_trial()])
    seen = acted(weight_model(), trial, [(pulley, 0.05)])
    np.testing.assert_allclose(seen["x_m"], 0.5 * FORCE / INERTIA * TIME**2, atol=1e-12)


def test_friction_may_be_less_than_that_of_the_model() -> None:
    model = weight_model(pulley_friction=0.08)
    (own,) = PulleyFriction().parameters(model, [weight_trial()])
    assert own.lower == -0.08
    seen = acted(model, weight_trial(), [(PulleyFriction(), -0.08)])
    np.testing.assert_allclose(seen["x_m"], 0.5 * FORCE / INERTIA * TIME**2, atol=1e-12)


def test_pulley_inertia_slows_the_body() -> None:
    seen = acted(weight_model(), weight_trial(), [(PulleyInertia(), 0.3)])
    np.testing.assert_allclose(seen["x_m"], 0.5 * FORCE / (INERTIA + 0.3) * TIME**2, atol=1e-12)


def test_viscous_pulley_brakes_exponentially() -> None:
    seen = acted(weight_model(), weight_trial(force=0.0), [(PulleyViscous(), 0.7), (InitialSpeed(), 0.3)])
    np.testing.assert_allclose(seen["u_m_s"], 0.3 * np.exp(-0.7 / INERTIA * TIME), rtol=1e-8)


def test_start_offset_and_initial_speed_change_the_start() -> None:
    seen = acted(weight_model(), weight_trial(), [(StartOffset(), 0.02), (InitialSpeed(), -0.1)])
    expected = 0.02 - 0.1 * TIME + 0.5 * FORCE / INERTIA * TIME**2
    np.testing.assert_allclose(seen["x_m"], expected, atol=1e-10)


def test_a_string_oscillates_under_a_constant_pull() -> None:
    omega, zeta, pull = 7.0, 0.2, -1.3
    time = np.sort(np.random.default_rng(1).uniform(0, 3, 200))
    time[0] = 0.0
    ring = omega * np.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * time)
    expected = (
        pull / omega**2 * (1 - decay * (np.cos(ring * time) + zeta * omega / ring * np.sin(ring * time)))
    )
    np.testing.assert_allclose(
        solve_oscillation(time, np.full(200, pull), omega, zeta, 0.0), expected, atol=1e-12
    )


def test_a_stiff_string_is_stretched_in_proportion_to_acceleration() -> None:
    compliance = 0.02
    seen = acted(weight_model(), weight_trial(), [(StringStretch(), (compliance, 0.0, 0.5))])
    settled = TIME > 1.0
    lag = seen["x_m"] - 0.5 * FORCE / INERTIA * TIME**2
    np.testing.assert_allclose(lag[settled], -compliance * FORCE / 9.81 * FORCE / INERTIA, rtol=1e-4)


def test_a_slack_string_takes_up_the_weight() -> None:
    compliance = 0.02
    seen = acted(weight_model(), weight_trial(), [(StringStretch(), (compliance, 1.0, 0.5))])
    taut = acted(weight_model(), weight_trial(), [(StringStretch(), (compliance, 0.0, 0.5))])
    late = (seen["x_m"] - taut["x_m"])[TIME > 1.0]
    np.testing.assert_allclose(late, compliance * FORCE, rtol=1e-3)
    assert abs(seen["x_m"][0]) < 1e-12


def test_forced_kernel_is_the_nominal_one_in_still_water() -> None:
    model = weight_model(quadratic_drag=2.0, pulley_friction=0.05)
    trial = weight_trial(release_s=0.13)
    plain = model.simulate(start(model), trial)
    forced = model.simulate_hooked(start(model), trial, Hooks(flow=(_still,)))
    np.testing.assert_allclose(forced["x_m"], plain["x_m"], atol=1e-10)
    decay = rig.free_decay("roll_rad", inertia=0.01, stiffness=1.0, guess=1.0, amplitude=0.3)
    values = start(decay, dry_friction=0.02)
    trial = Trial("d", "fit", TIME, {}, rig=RigInput(inertia=0.01, x0=0.3))
    plain, forced = decay.simulate(values, trial), decay.simulate_hooked(values, trial, Hooks(flow=(_still,)))
    np.testing.assert_array_equal(forced["roll_rad"], plain["roll_rad"])


def test_a_late_clock_shows_earlier_states() -> None:
    model = weight_model()
    late = model.simulate_hooked(start(model), weight_trial(), Hooks(clock_s=0.5))
    before = np.maximum(TIME - 0.5, 0.0)
    np.testing.assert_allclose(late["x_m"], 0.5 * FORCE / INERTIA * before**2, atol=1e-12)


def test_late_clock_under_a_measured_force_delays_the_motion_not_the_force() -> None:
    model = rig.make_towed_model(mass_kg=INERTIA, force_N=0.2, area_known=False)
    known = RigInput(inertia=INERTIA, release_s=0.0)
    trial = Trial("t", "fit", TIME, {}, inputs={"force_N": 0.1 * TIME}, rig=known)
    values = start(model, quadratic_drag=0.0, added_mass=0.0)
    late = model.simulate_hooked(values, trial, Hooks(clock_s=0.5))
    before = np.maximum(TIME - 0.5, 0.0)
    np.testing.assert_allclose(late["x_m"], 0.1 * before**3 / (6 * INERTIA), atol=1e-9)


def test_more_forces_than_the_kernel_takes_are_refused() -> None:
    model = weight_model()
    many = Hooks(force=(ExternalForce(no_force, np.zeros(1)),) * 5)
    with pytest.raises(ValueError, match="at most 4"):
        model.simulate_hooked(start(model), weight_trial(), many)
