"""Effects of fins, joints and masses, against robots that have them built in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from swimid.effects.base import Effect
from swimid.effects.structure.com_offset import ComOffset
from swimid.effects.structure.fin_flexibility import FinFlexibility, bent_fin
from swimid.effects.structure.joint_damping import JointDamping
from swimid.effects.structure.joint_locked import JointLocked
from swimid.effects.structure.joint_stiffness import JointStiffness
from swimid.effects.structure.water_ingress import WaterIngress
from swimid.fitting.hooks import Stroke
from swimid.fitting.inputs import CruiseInput, RigInput
from swimid.fitting.model import Trial
from swimid.propulsion.model import RecoilModel
from swimid.rig import model as rig
from swimid.robots import file as robots
from swimid.robots.planar import Hydrostatics
from tests.effect_cases import (
    INERTIA,
    TIME,
    acted,
    changed,
    check_null,
    start,
    swim,
    swimmer,
    weight_model,
    weight_trial,
)

ALL = [ComOffset(), FinFlexibility(), JointDamping(), JointLocked(), JointStiffness(), WaterIngress()]


@pytest.mark.parametrize("robot", ["tfish", "dolphin"])
@pytest.mark.parametrize("effect", ALL, ids=lambda e: e.name)
def test_null_and_tries_of_swimmers(effect: Effect, robot: str) -> None:
    model = swimmer(robot)
    check_null(model, swim(model), effect)


def _like(robot: str, change: Callable[[Any], None], effect: Effect, values: Any) -> None:
    """An effect moves a robot as the change of its file does."""
    model, built = swimmer(robot), changed(robots.read(robot), change)
    trial = swim(model)
    seen, expected = acted(model, trial, [(effect, values)]), built.simulate(start(built), trial)
    plain = model.simulate(start(model), trial)
    for name in model.pose:
        np.testing.assert_allclose(seen[name], expected[name], atol=1e-9)
        assert np.abs(seen[name] - plain[name]).max() > 1e-4


def test_water_is_mass_at_the_centre_of_mass() -> None:
    def flooded(body: Any) -> None:
        head = body.links[0]
        head.mass_kg, head.inertia_kg_m2 = 2.133 + 0.3, 0.0916 + 0.3 * 0.192**2

    _like("tfish", flooded, WaterIngress(), 0.3)


def test_water_in_a_rig_weighs_and_in_a_cruise_delays() -> None:
    seen = acted(weight_model(), weight_trial(), [(WaterIngress(), 0.2)])
    np.testing.assert_allclose(seen["x_m"], 0.5 * 0.2 / (INERTIA + 0.2) * TIME**2, atol=1e-12)
    light, heavy = (RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=m, fins={"a": 1e-4}) for m in (1.9, 2.2))
    inputs = {name: np.full(3, v) for name, v in (("frequency_hz", 2.0), ("amplitude_rad", 0.4))}
    inputs["distance_m"] = np.array([0.5, 1.0, 2.0])
    cruise = CruiseInput(fin="a", inertia_kg_m2=1e-4, middle=(2.0, 0.4))
    trial = Trial("a", "fit", np.arange(3.0), {}, inputs=inputs, cruise=cruise)
    seen = acted(light, trial, [(WaterIngress(), 0.3)])
    expected = heavy.simulate(start(heavy), trial)
    np.testing.assert_allclose(seen["mean_speed_m_s"], expected["mean_speed_m_s"], rtol=1e-12)


def test_centre_of_mass_moves() -> None:
    def moved(body: Any) -> None:
        head = body.links[0]
        central = 0.0916 - 2.133 * 0.192**2
        head.com_m, head.com_offset_m = 0.192 - 0.008, 0.003
        head.inertia_about, head.inertia_kg_m2 = "com", central
        for element in body.elements:
            if element.name == "head-added":
                element.at_m = 0.192

    _like("tfish", moved, ComOffset(), (0.008, 0.003))


def test_weight_moves_with_the_centre_of_mass() -> None:
    """A buoyant trunk whose weight moves forward pitches down."""

    def floating(body: Any) -> None:
        body.elements.append(
            Hydrostatics(kind="hydrostatics", name="float", link="trunk", volume_m3=2.83 / 1000)
        )

    model = changed(robots.read("dolphin"), floating)
    trial = swim(model, amplitude_rad=0.0, duration_s=1.0, pose=(0.0, 0.0, 0.0))
    ahead = acted(model, trial, [(ComOffset(), (0.01, 0.0))])["pitch_rad"]
    assert ahead[-1] < -1e-3
    level = model.simulate(start(model), trial)["pitch_rad"]
    assert np.abs(level).max() < 1e-9


def test_stiffer_joint() -> None:
    def stiffer(body: Any) -> None:
        body.coefficients["K_s"].value *= 1.4

    _like("dolphin", stiffer, JointStiffness(), [0.4, 0.0])


def test_stiffer_decay_swings_faster() -> None:
    model = rig.free_decay("roll_rad", inertia=0.01, stiffness=1.0, guess=1.0, amplitude=0.3)
    trial = Trial("d", "fit", TIME, {}, rig=RigInput(inertia=0.01, x0=0.3))
    still = {"quadratic_damping": 0.0, "linear_damping": 0.0}
    seen = acted(model, trial, [(JointStiffness(), 0.21)], **still)
    np.testing.assert_allclose(seen["roll_rad"], 0.3 * np.cos(11.0 * TIME), atol=2e-4)
    free = rig.free_decay("roll_rad", inertia=0.01, stiffness=None, guess=1.0, amplitude=0.3)
    assert not JointStiffness().variants(free, [trial])


def test_damped_joint() -> None:
    def damped(body: Any) -> None:
        body.joints[3].passive.damping_N_m_s_rad = 0.004

    _like("tfish", damped, JointDamping(), 0.004)


def test_a_locked_passive_joint_hardly_moves() -> None:
    for robot, column in (("tfish", "joint4_rad"), ("dolphin", "joint3_rad")):
        model = swimmer(robot)
        trial = swim(model)
        free = model.simulate(start(model), trial)[column]
        held = acted(model, trial, [(JointLocked(column), 0.97)])[column]
        assert np.ptp(held) < 0.1 * np.ptp(free)


def test_a_locked_driven_joint_moves_by_its_share() -> None:
    model = swimmer("tfish")
    trial = swim(model)
    free = model.simulate(start(model), trial)
    held = acted(model, trial, [(JointLocked("joint2_rad"), 0.6)])
    np.testing.assert_allclose(held["joint2_rad"], 0.4 * free["joint2_rad"], atol=1e-3)
    np.testing.assert_array_equal(held["joint1_rad"], free["joint1_rad"])


def test_every_joint_that_moves_can_be_locked() -> None:
    model = swimmer("tfish")
    columns = [v.column for v in JointLocked().variants(model, [swim(model)])]
    assert columns == ["joint1_rad", "joint2_rad", "joint3_rad", "joint4_rad"]
    model = swimmer("dolphin")  # its neck is kept still
    assert [v.column for v in JointLocked().variants(model, [swim(model)])] == ["joint2_rad", "joint3_rad"]


@pytest.mark.parametrize("w", [0.3, -0.3])
def test_a_bent_fin_pushes_forwards_with_less_load(w: float) -> None:
    compliance, gain = 0.01, 20.0
    wrench = np.zeros(3)
    bent_fin._pyfunc(0.0, np.zeros(3), np.array([0.0, w, 0.0]), np.array([compliance, gain, 0.0]), wrench)
    load = gain * w * w
    assert wrench[0] == pytest.approx(compliance * load**2, rel=1e-2)
    # the speed across the bent chord falls as its cosine, the force as the square, its part across once more
    angle = compliance * load
    assert wrench[1] * np.sign(w) == pytest.approx(1.5 * angle**2 * load, rel=2e-2)


def test_a_fin_that_bends_loses_thrust_by_its_load() -> None:
    stroke = Stroke(np.array([1.0, 2.0]), np.array([0.3, 0.3]), np.ones(2), 2e-4)
    effect = FinFlexibility(load=2e-4 * 0.3, inertia_kg_m2=1.0)
    cruise = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 2e-4})
    trial = Trial("a", "fit", np.arange(2.0), {})
    bent = effect.hooks(np.array([0.5]), trial, cruise).beaten(stroke)
    np.testing.assert_allclose(bent.thrust, [1 / 1.5, 1 / 3.0])
