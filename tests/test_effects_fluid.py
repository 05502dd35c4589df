"""Effects of the water on the body, against closed forms and against robots that have them built in."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swimid.effects.base import Effect
from swimid.effects.environment import Tether
from swimid.effects.fluid import (
    AddedMassFactor,
    DragReynolds,
    LiftDamping,
    LinearDrag,
    QuadraticDrag,
    WakeLift,
)
from swimid.effects.rig import InitialSpeed
from swimid.fitting.model import CruiseInput, RigInput, SurgeInput, Trial
from swimid.propulsion.model import RecoilModel, SurgeModel
from swimid.rig import model as rig
from swimid.robots import file as robots
from swimid.robots.planar import PlanarAddedMass as AddedMassElement
from swimid.robots.planar import PlanarFoil, TrailingEdge
from tests.effect_cases import (
    INERTIA,
    TIME,
    acted,
    changed,
    check_null,
    coasting,
    dry_fish,
    start,
    swim,
    swimmer,
    weight_model,
    weight_trial,
)

ALL = [AddedMassFactor(), DragReynolds(), LinearDrag(), WakeLift(), LiftDamping()]


@pytest.mark.parametrize("robot", ["tfish", "dolphin"])
@pytest.mark.parametrize("effect", ALL, ids=lambda e: e.name)
def test_null_and_tries_of_swimmers(effect: Effect, robot: str) -> None:
    model = swimmer(robot)
    check_null(model, swim(model), effect)


@pytest.mark.parametrize("effect", ALL[:3], ids=lambda e: e.name)
def test_null_and_tries_of_rigs(effect: Effect) -> None:
    check_null(weight_model(quadratic_drag=2.0, added_mass=0.4), weight_trial(), effect)


def test_linear_drag_of_a_model_that_estimates_it_is_no_effect() -> None:
    model = weight_model()
    model.parameters = tuple(
        replace(p, free=True) if p.name == "linear_drag" else p for p in model.parameters
    )
    assert not LinearDrag().variants(model, [weight_trial()])


def test_linear_drag_of_a_coasting_fish_brakes_exponentially() -> None:
    model = dry_fish()
    mass = 2.133 + 3 * 0.081 + 0.096
    seen = acted(model, coasting(model), [(LinearDrag(), 0.8)], initial_surge=0.3)
    time = coasting(model).time_s
    np.testing.assert_allclose(seen["u_m_s"], 0.3 * np.exp(-0.8 / mass * time), rtol=1e-7)


def test_linear_drag_of_a_cruise_takes_a_share_of_the_power() -> None:
    model = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4})
    inputs = {
        "frequency_hz": np.array([2.0, 3.0]),
        "amplitude_rad": np.array([0.4, 0.4]),
        "distance_m": np.full(2, 1e4),
    }
    cruise = CruiseInput(fin="a", inertia_kg_m2=1e-4, middle=(2.5, 0.4))
    trial = Trial("a", "fit", np.arange(2.0), {}, inputs=inputs, cruise=cruise)
    free = model.simulate(start(model), trial)["mean_speed_m_s"]
    slow = acted(model, trial, [(LinearDrag(), 0.5)])["mean_speed_m_s"]
    np.testing.assert_allclose(2.4 * slow**3 + 0.5 * slow**2, 2.4 * free**3, rtol=2e-3)


def test_linear_drag_of_a_surge_model_is_per_mass() -> None:
    model = SurgeModel(amplitudes_rad=[0.3], frequencies_hz=[1.0], speed_m_s=0.3)
    time = np.linspace(0.0, 200.0, 400)
    surge = SurgeInput(amplitude_rad=0.3, frequency_hz=1.0, start_s=0.0)
    trial = Trial("s", "fit", time, {"u_m_s": 0.3 + 0 * time}, surge=surge)
    (own,) = LinearDrag().parameters(model, [trial])
    assert own.unit == "1/s"
    slow = acted(model, trial, [(LinearDrag(), 0.4)], thrust_acceleration=0.1, surge_drag=1.2)["u_m_s"][-1]
    assert 1.2 * slow**2 + 0.4 * slow == pytest.approx(0.1, rel=1e-6)


@pytest.mark.parametrize("n", [-0.5, 0.2, 0.5])
def test_drag_that_changes_with_speed_in_closed_form(n: float) -> None:
    drag, v0, ref = 3.0, 0.4, 0.25
    seen = acted(
        weight_model(quadratic_drag=drag),
        weight_trial(force=0.0),
        [(DragReynolds(ref), n), (InitialSpeed(), v0)],
    )
    gain = drag * ref**n / INERTIA
    speed = (v0 ** (n - 1) + (1 - n) * gain * TIME) ** (1 / (n - 1))
    np.testing.assert_allclose(seen["u_m_s"], speed, rtol=1e-6)


def test_drag_of_a_coasting_fish_that_changes_with_speed_in_closed_form() -> None:
    n, ref, v0 = 0.5, 0.2, 0.3
    model = dry_fish()
    model = swimmer("tfish", **{p.name: 0.0 for p in model.parameters[:8]} | {"c_f0": 1.0})
    area = 0.5 * 1000 * 0.012727
    seen = acted(model, coasting(model), [(DragReynolds(ref), n)], initial_surge=v0)
    mass = 2.133 + 3 * 0.081 + 0.096
    gain = area * ref**n / mass
    speed = (v0 ** (n - 1) + (1 - n) * gain * coasting(model).time_s) ** (1 / (n - 1))
    np.testing.assert_allclose(seen["u_m_s"], speed, rtol=1e-6)


def test_drag_that_changes_from_trial_to_trial_is_that_of_the_robot_file() -> None:
    """At twice the reference speed all coefficients change by ``2^-n``."""
    names = ("c_d0", "c_d13", "c_d4", "c_f0", "c_f13", "c_f4")
    model = swimmer("tfish")
    trial = swim(model)
    effect = DragReynolds(0.5 * model.scales([trial]).speed, whole=True)
    seen = acted(model, trial, [(effect, 0.5)])
    values = {p.name: p.start * 2.0**-0.5 for p in model.parameters if p.name in names}
    slick = swimmer("tfish", **values)
    expected = slick.simulate(start(slick), trial)
    for name in ("x_m", "y_m", "yaw_rad"):
        np.testing.assert_allclose(seen[name], expected[name], atol=1e-10)


def test_drag_does_not_change_between_trials_at_one_speed() -> None:
    """The speeds of repeats differ by chance, which would give a large exponent."""
    model = swimmer("tfish")
    one, slower, other = (swim(model, frequency_hz=f) for f in (1.2, 1.19, 1.6))
    for trials, told in (([one, slower], False), ([one, slower, other], True)):
        assert any(e.whole for e in DragReynolds().variants(model, trials)) == told


def test_added_mass_slows_a_swing_on_a_tether() -> None:
    model = dry_fish()
    mass, k, extra = 2.133 + 3 * 0.081 + 0.096, 30.0, 1.1
    trial = coasting(model)
    seen = acted(
        model,
        trial,
        [(Tether(), (k, 0.0, 0.0, 0.0)), (AddedMassFactor(), (extra, 0.0, 0.0))],
        initial_surge=0.3,
    )
    rate = np.sqrt(k / (mass + extra))
    np.testing.assert_allclose(seen["x_m"], 0.3 / rate * np.sin(rate * trial.time_s), atol=1e-7)


def test_added_mass_of_a_swimmer_is_that_of_the_robot_file() -> None:
    def heavier(body: Any) -> None:
        masses = {link.name: link.mass_kg for link in body.links}
        whole = sum(masses.values())
        for name, mass in masses.items():
            share = mass / whole
            body.elements.append(
                AddedMassElement(
                    kind="added-mass",
                    name=f"{name}-more",
                    link=name,
                    surge_kg=0.4 * share,
                    sway_kg=0.7 * share + (0.02 if name == list(masses)[-1] else 0.0),
                )
            )

    model, built = swimmer("tfish"), changed(robots.read("tfish"), heavier)
    trial = swim(model)
    seen = acted(model, trial, [(AddedMassFactor(), (0.4, 0.7, 0.02))])
    expected = built.simulate(start(built), trial)
    for name in ("x_m", "y_m", "yaw_rad"):
        np.testing.assert_allclose(seen[name], expected[name], atol=1e-10)


def test_added_mass_slows_a_rig() -> None:
    seen = acted(weight_model(), weight_trial(), [(AddedMassFactor(), 0.6)])
    np.testing.assert_allclose(seen["x_m"], 0.5 * 0.2 / (INERTIA + 0.6) * TIME**2, atol=1e-12)


def test_wake_is_the_trailing_edge_of_the_robot_file() -> None:
    def edge(body: Any) -> None:
        body.elements.append(TrailingEdge(kind="trailing-edge", name="edge", link="fin", added_mass_kg_m=0.8))

    model, built = swimmer("tfish"), changed(robots.read("tfish"), edge)
    trial = swim(model)
    seen, expected = acted(model, trial, [(WakeLift(), 0.8)]), built.simulate(start(built), trial)
    # Two kernels compute them: one with the elements of effects, and that of the robot file.
    for name in ("x_m", "y_m", "yaw_rad"):
        np.testing.assert_allclose(seen[name], expected[name], rtol=0, atol=1e-12)


def test_quadratic_drag_of_a_coasting_rig_in_closed_form() -> None:
    c, v0 = 2.5, 0.4
    seen = acted(
        weight_model(quadratic_drag=0.0),
        weight_trial(force=0.0),
        [(QuadraticDrag(), c), (InitialSpeed(), v0)],
    )
    np.testing.assert_allclose(seen["u_m_s"], v0 / (1 + c * v0 / INERTIA * TIME), rtol=1e-6)


def test_quadratic_drag_adds_to_the_models_own() -> None:
    model = weight_model(quadratic_drag=2.0)
    (own,) = QuadraticDrag().parameters(_held(model), [weight_trial()])
    assert (own.start, own.lower) == (0.0, -2.0)
    both = model.simulate(start(model, quadratic_drag=3.5), weight_trial())
    seen = acted(model, weight_trial(), [(QuadraticDrag(), 1.5)])
    np.testing.assert_allclose(seen["x_m"], both["x_m"], rtol=1e-12)


def test_quadratic_damping_of_a_decay_has_the_closed_form_loss() -> None:
    """Slowly varying amplitude (Krylov and Bogoliubov): ``dA/dt = -4 c omega A^2 / (3 pi I)``."""
    inertia, stiffness, amplitude, c = 0.5, 8.0, 0.3, 0.02
    model = rig.free_decay(
        "roll_rad", inertia=inertia, stiffness=stiffness, guess=stiffness, amplitude=amplitude
    )
    model.parameters = tuple(
        replace(p, start=0.0, free=False) if p.name.endswith("_damping") else p for p in model.parameters
    )
    omega = np.sqrt(stiffness / inertia)
    time = 2 * np.pi / omega * np.arange(41)
    trial = Trial("d", "fit", time, {"roll_rad": 0 * time}, rig=RigInput(inertia=inertia, x0=amplitude))
    (own,) = QuadraticDrag().parameters(model, [trial])
    assert own.unit == "N m s^2/rad^2"
    seen = acted(model, trial, [(QuadraticDrag(), c)])
    energy = 0.5 * stiffness * seen["roll_rad"] ** 2 + 0.5 * inertia * seen["roll_rate_rad_s"] ** 2
    expected = amplitude / (1 + 4 * c * amplitude * omega * time / (3 * np.pi * inertia))
    np.testing.assert_allclose(np.sqrt(2 * energy / stiffness), expected, rtol=1e-3)


def test_quadratic_drag_that_the_model_estimates_is_no_effect() -> None:
    assert not QuadraticDrag().variants(weight_model(), [weight_trial()])
    assert QuadraticDrag().variants(_held(weight_model()), [weight_trial()])
    assert not QuadraticDrag().variants(dry_fish(), [])


def test_null_and_tries_of_quadratic_drag() -> None:
    check_null(_held(weight_model(quadratic_drag=2.0, added_mass=0.4)), weight_trial(), QuadraticDrag())


def _held(model: rig.RigModel) -> rig.RigModel:
    model.parameters = tuple(
        replace(p, free=False) if p.name == "quadratic_drag" else p for p in model.parameters
    )
    return model


def test_lift_of_the_links_is_that_of_plates_in_the_robot_file() -> None:
    """The reference has lift and drag of a plate without force along it, distributed as its drag across."""

    def plates(body: Any) -> None:
        known = {name: c.value for name, c in body.coefficients.items()}
        across = {"head": 0.028909 * known["c_d0"], "fin": 0.006853 * known["c_d4"]}
        for link, area in (("tail1", 0.009047), ("tail2", 0.009099), ("tail3", 0.008621)):
            across[link] = area * known["c_d13"]
        middle = {"head": 0.135, "tail1": 0.016, "tail2": 0.016, "tail3": 0.016, "fin": 0.05}
        for link, share in across.items():
            body.elements.append(
                PlanarFoil(
                    kind="foil",
                    name=f"{link}-plate",
                    link=link,
                    at_m=middle[link],
                    area_m2=20.0 * share / sum(across.values()) / 500.0,
                    lift_coefficient=0.5,
                    drag_coefficient_1=0.5,
                )
            )

    model, built = swimmer("tfish"), changed(robots.read("tfish"), plates)
    trial = swim(model)
    seen, expected = acted(model, trial, [(LiftDamping(), 20.0)]), built.simulate(start(built), trial)
    for name in ("x_m", "y_m", "yaw_rad"):
        np.testing.assert_allclose(seen[name], expected[name], atol=1e-10)


def test_lift_acts_only_across_a_link() -> None:
    """In a glide at an angle ``-k V w`` is the force of the added plates, which have no part along them."""
    body = swimmer("tfish").body
    tables = body.tables()
    plain = len(tables["foil"])
    body.lift(tables, np.array([0]), np.array([[-0.1, 0.0, 3.0]]))
    (_, _, half, cl, cd0, cd1, *_) = tables["foil"][plain]
    u, w = 0.4, -0.3
    speed, attack = np.hypot(u, w), np.arctan2(w, u)
    lift, drag = cl * np.sin(2 * attack), cd0 + cd1 * (1 - np.cos(2 * attack))
    along = half * speed * (lift * w - drag * u)
    across = half * speed * (-lift * u - drag * w)
    assert along == pytest.approx(0.0, abs=1e-12)
    assert across == pytest.approx(-3.0 * speed * w)


def test_lift_of_the_links_does_not_apply_without_drag_across_them() -> None:
    assert not LiftDamping().variants(dry_fish(), [])
    assert not LiftDamping().variants(weight_model(), [weight_trial()])
