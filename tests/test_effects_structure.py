"""Effects of fins, joints and masses, against robots that have them built in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from swimid.effects.base import Effect
from swimid.effects.environment import Current
from swimid.effects.rig import InitialSpeed
from swimid.effects.structure import (
    ComOffset,
    FinFlexibility,
    Hardening,
    JointDamping,
    JointFriction,
    JointLocked,
    JointStiffness,
    LoadFriction,
    Stribeck,
    WaterIngress,
    add_bent_fin_force,
)
from swimid.fitting.model import CruiseInput, RigInput, Stroke, Trial
from swimid.propulsion.model import RecoilModel
from swimid.rig import model as rig
from swimid.robots import file as robots
from swimid.robots.joints import Input
from swimid.robots.planar import PlanarHydrostatics, PlanarLoad
from tests.effect_cases import (
    FORCE,
    INERTIA,
    TIME,
    acted,
    changed,
    check_null,
    dry_fish,
    start,
    swim,
    swimmer,
    weight_model,
    weight_trial,
)

ALL = [
    ComOffset(),
    FinFlexibility(),
    Hardening(),
    JointDamping(),
    JointFriction(),
    JointLocked(),
    JointStiffness(),
    LoadFriction(),
    Stribeck(),
    WaterIngress(),
]
ROLL = rig.free_decay("roll_rad", inertia=0.01, stiffness=1.0, guess=1.0, amplitude=0.3)
RELEASED = Trial("d", "fit", TIME, {"roll_rad": 0.3 * np.cos(10 * TIME)}, rig=RigInput(inertia=0.01, x0=0.3))
UNDAMPED = {"quadratic_damping": 0.0, "linear_damping": 0.0}
TOW = rig.make_towed_model(mass_kg=INERTIA, force_N=0.2, area_known=False)
TOWED = Trial(
    "t",
    "fit",
    TIME,
    {"x_m": 0.1 * TIME},
    inputs={"force_N": 0.1 * TIME},
    rig=RigInput(inertia=INERTIA, release_s=0.0),
)


@pytest.mark.parametrize("robot", ["tfish", "dolphin"])
@pytest.mark.parametrize("effect", ALL, ids=lambda e: e.name)
def test_null_and_tries_of_swimmers(effect: Effect, robot: str) -> None:
    model = swimmer(robot)
    check_null(model, swim(model), effect)


def _like(robot: str, change: Callable[[Any], None], effect: Effect, values: Any) -> None:
    """Check that an effect moves a robot as the change of its file does."""
    model, built = swimmer(robot), changed(robots.read(robot), change)
    trial = swim(model)
    seen, expected = acted(model, trial, [(effect, values)]), built.simulate(start(built), trial)
    plain = model.simulate(start(model), trial)
    for name in model.pose:
        np.testing.assert_allclose(seen[name], expected[name], atol=1e-9)
        assert np.abs(seen[name] - plain[name]).max() > 1e-4


@pytest.mark.parametrize("along", [0.0, -0.05])
def test_water_is_a_mass_at_its_place(along: float) -> None:
    def flooded(body: Any) -> None:
        head, water = body.links[0], 0.3
        mass, com = 2.133 + water, 0.192 - water * along / (2.133 + water)
        head.inertia_kg_m2 = 0.0916 + water * (0.192 - along) ** 2
        head.mass_kg, head.com_m = mass, com
        for element in body.elements:
            if element.name == "head-added":
                element.at_m = 0.192

    _like("tfish", flooded, WaterIngress(), (0.3, along))


def test_water_slows_a_rig_and_a_cruise() -> None:
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


def test_centre_of_mass_stays_within_its_link() -> None:
    """The head of the fish is 0.27 m long, and its centre of mass lies 0.192 m behind the front end."""
    along, across = ComOffset().parameters(swimmer("tfish"), [])
    assert (along.scale, across.scale) == pytest.approx((0.0027, 0.0027))
    assert (across.lower, across.upper) == pytest.approx((-0.054, 0.054))
    assert (along.lower, along.upper) == (pytest.approx(0.192 - 0.27), pytest.approx(0.192))


def test_weight_moves_with_the_centre_of_mass() -> None:
    """A buoyant trunk whose weight moves forward pitches down."""

    def floating(body: Any) -> None:
        body.elements.append(
            PlanarHydrostatics(kind="hydrostatics", name="float", link="trunk", volume_m3=2.83 / 1000)
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


def test_friction_of_a_joint() -> None:
    def rough(body: Any) -> None:
        body.joints[3].passive.friction_N_m = 0.004

    _like("tfish", rough, JointFriction(), 0.004)


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
    add_bent_fin_force._pyfunc(
        0.0, np.zeros(3), np.array([0.0, w, 0.0]), np.array([compliance, gain, 0.0]), wrench
    )
    load = gain * w * w
    assert wrench[0] == pytest.approx(compliance * load**2, rel=1e-2)
    # the speed across the bent chord is reduced by its cosine, the force by its square, its part across by
    # another
    angle = compliance * load
    assert wrench[1] * np.sign(w) == pytest.approx(1.5 * angle**2 * load, rel=2e-2)


def test_a_fin_that_bends_loses_thrust_by_its_load() -> None:
    stroke = Stroke(np.array([1.0, 2.0]), np.array([0.3, 0.3]), np.ones(2), 2e-4)
    effect = FinFlexibility(load=2e-4 * 0.3, inertia_kg_m2=1.0)
    cruise = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 2e-4})
    trial = Trial("a", "fit", np.arange(2.0), {})
    bent = effect.hooks(np.array([0.5]), trial, cruise).change_stroke(stroke)
    np.testing.assert_allclose(bent.thrust, [1 / 1.5, 1 / 3.0])


# ---------------------------------------------------------------- hardening


@pytest.mark.parametrize("effect", [Hardening(), LoadFriction(), Stribeck()], ids=lambda e: e.name)
def test_null_and_tries_of_a_decay(effect: Effect) -> None:
    check_null(ROLL, RELEASED, effect)


@pytest.mark.parametrize("effect", [LoadFriction(), Stribeck()], ids=lambda e: e.name)
def test_null_and_tries_of_pulled_bodies(effect: Effect) -> None:
    check_null(weight_model(quadratic_drag=2.0, added_mass=0.4), weight_trial(), effect)
    check_null(TOW, TOWED, effect)


def test_load_friction_leaves_the_commands_of_thrusters_alone() -> None:
    def thrust(body: Any) -> None:
        body.inputs["stern"] = Input(column="stern_N")
        body.elements.append(PlanarLoad(kind="load", link="head", input="stern", at_m=0.1, forward_N=1.0))

    model, plain = changed(robots.read("tfish"), thrust), swimmer("tfish")
    pushed = swim(plain)
    pushed = replace(pushed, swim=replace(pushed.swim, inputs={"stern": lambda t: 0.1 * np.sin(t)}))
    (size,) = LoadFriction().parameters(plain, [swim(plain)])
    (found,) = LoadFriction().parameters(model, [pushed])
    assert found == size
    (change,) = LoadFriction().hooks(np.array([found.scale]), pushed, model).command
    thrusts = np.sin(TIME)
    np.testing.assert_array_equal(change(TIME, thrusts, len(model.driven)), thrusts)
    assert np.abs(change(TIME, thrusts, 0) - thrusts).max() > 0.0


def test_where_hardening_and_frictions_do_not_apply() -> None:
    cruise = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4})
    for effect in (Hardening(), LoadFriction(), Stribeck()):
        assert not effect.variants(cruise, [])
    assert not Hardening().variants(TOW, [TOWED])
    held = swim(swimmer("tfish"))
    measured = replace(held, swim=replace(held.swim, beat=None, joints=[lambda t: (t, t, t)] * 3))
    for effect in (LoadFriction(), Stribeck()):
        assert not effect.variants(swimmer("tfish"), [measured])


def test_a_spring_that_hardens_is_the_cubic_one_of_the_robot_file() -> None:
    def cubic(body: Any) -> None:
        body.joints[2].passive.cubic_N_m_rad3 = 0.31 * 40.0

    _like("dolphin", cubic, Hardening(), 40.0)


def test_a_decay_that_hardens_swings_in_duffings_period() -> None:
    """The period follows from the energy: ``T = 4 int dphi / sqrt(1 + h/2 A^2 (1 + sin^2 phi)) / omega``."""
    h, size = 4.0, 0.3
    period = 0.4 * quad(lambda p: 1 / np.sqrt(1 + 0.5 * h * size**2 * (1 + np.sin(p) ** 2)), 0, np.pi / 2)[0]
    time = period * np.arange(7)
    trial = replace(RELEASED, time_s=time, measured={"roll_rad": 0 * time})
    seen = acted(ROLL.refine().refine(), trial, [(Hardening(), h)], **UNDAMPED)
    np.testing.assert_allclose(seen["roll_rad"], size, atol=2e-5)


# ---------------------------------------------------------------- friction


def test_stribeck_friction_holds_a_body_until_the_pull_exceeds_it() -> None:
    rest = acted(weight_model(), weight_trial(), [(Stribeck(), (FORCE * 1.01, 0.05))])
    np.testing.assert_array_equal(rest["x_m"], 0.0)
    # far beyond the Stribeck speed there is no friction, and the speed lags by the impulse lost before
    seen = acted(weight_model(), weight_trial(), [(Stribeck(), (0.1, 0.02))])
    late = TIME > 2.0
    assert np.ptp((seen["u_m_s"] - FORCE / INERTIA * TIME)[late]) < 1e-9


def test_stribeck_friction_dissipates_the_closed_form_energy() -> None:
    """Coasting from v0 to v1 covers ``x = int M v / (rise exp(-(v / v_s)^2)) dv``, in closed form."""
    rise, slow, v0 = 0.05, 0.1, 0.08
    seen = acted(weight_model(), weight_trial(force=0.0), [(Stribeck(), (rise, slow)), (InitialSpeed(), v0)])
    gone = 0.5 * INERTIA * slow**2 / rise * (np.exp((v0 / slow) ** 2) - np.exp((seen["u_m_s"] / slow) ** 2))
    np.testing.assert_allclose(seen["x_m"], gone, atol=1e-7)
    assert seen["u_m_s"][-1] == 0.0


def test_friction_in_a_current_is_against_the_ground() -> None:
    """A body at rest on its slide stays there in any current."""
    model, trial = weight_model(), weight_trial(force=0.0)
    seen = acted(model, trial, [(Stribeck(), (0.1, 0.05)), (Current(), 0.3)])
    np.testing.assert_allclose(seen["x_m"], 0.0, atol=1e-12)


def test_friction_under_load_is_a_share_of_the_pull() -> None:
    seen = acted(weight_model(), weight_trial(), [(LoadFriction(), 0.1)])
    np.testing.assert_allclose(seen["x_m"], 0.5 * 0.9 * FORCE / INERTIA * TIME**2, atol=1e-12)
    free = acted(weight_model(), weight_trial(pulley=False), [(LoadFriction(), 0.1)])
    np.testing.assert_allclose(free["x_m"], 0.5 * FORCE / INERTIA * TIME**2, atol=1e-12)
    still = {"quadratic_drag": 0.0, "added_mass": 0.0}
    towed = acted(TOW, TOWED, [(LoadFriction(everywhere=True), 0.1)], **still)
    # below 2 % of the typical speed the rounded sign reduces the friction
    np.testing.assert_allclose(towed["x_m"], 0.9 * 0.1 * TIME**3 / (6 * INERTIA), atol=1e-3)
    assert np.ptp(towed["x_m"]) > 0.7


def test_friction_under_the_load_of_a_spring_damps_each_swing_by_a_share() -> None:
    """The spring is ``1 - mu`` times as stiff on the way in and ``1 + mu`` on the way out (Reid)."""
    mu, time = 0.03, np.linspace(0.0, 4.0, 4001)
    trial = replace(RELEASED, time_s=time, measured={"roll_rad": 0.3 * np.cos(10 * time)})
    seen = acted(ROLL, trial, [(LoadFriction(everywhere=True), mu)], **UNDAMPED)["roll_rad"]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(seen)))) + 1
    assert len(turns) == 12
    left = ((1 - mu) / (1 + mu)) ** (0.5 * np.arange(1, 13))
    # the rounded sign leaves half a per mille more at each turn
    np.testing.assert_allclose(np.abs(seen[turns]) / 0.3, left, rtol=0.006)


def test_the_load_of_a_servo_is_that_of_the_links_behind_it() -> None:
    """The cases are the tail of the fish without water, and a plate in water, about the first joint."""
    body = dry_fish().body
    masses, places = (0.081, 0.081, 0.081, 0.096), (0.016, 0.048, 0.080, 0.123)
    inertia = 2.3e-4 + 2.3e-4 + 2.1e-4 + 8.0e-5 + np.dot(masses, np.square(places))
    assert body.compute_actuator_load(body.tables(), 0) == pytest.approx((inertia, 0.0))
    bodies = swimmer("tfish", c_d13=0.0, c_d4=2.0).body
    drag = 500.0 * 0.006853 * 2.0 * (3 * 0.032 + 0.05) ** 3
    assert bodies.compute_actuator_load(bodies.tables(), 0)[1] == pytest.approx(drag, rel=1e-9)


def servo(effect: Effect, values: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rate of a joint's command, its lag along it, and the ratio of its largest angles."""
    model = swimmer("tfish")
    trial = swim(model, duration_s=4.0)
    told = model.simulate(start(model), trial)["joint2_rad"]
    done = acted(model, trial, [(effect, values)])["joint2_rad"]
    late = trial.time_s > 1.5
    rate = np.gradient(told, trial.time_s)[late]
    return rate, ((told - done)[late] * np.sign(rate)), done[late].max() / told[late].max()


def test_a_servo_sticks_where_its_command_turns_round() -> None:
    rate, back, top = servo(Stribeck(), (0.02, 0.3))
    fast, slow = (
        np.abs(back[m]).mean() for m in (abs(rate) > 0.8 * rate.max(), abs(rate) < 0.2 * rate.max())
    )
    # at full speed nearly nothing of it remains: exp(-(0.8 w / w_s)^2) with w / w_s = 3.3
    assert fast < 5e-4
    assert slow > 0.005
    assert 0.8 < top < 0.95


def test_a_servo_under_load_is_held_back_by_its_torque() -> None:
    """At full speed the torque is that of drag, ``D q'^2``; before and after, inertia adds or reduces it."""
    share, body = 0.4, swimmer("tfish").body
    _, drag = body.compute_actuator_load(body.tables(), 1)
    rate, back, top = servo(LoadFriction(), share)
    full = np.abs(rate) > 0.98 * rate.max()
    assert back[full].mean() == pytest.approx((share * drag * rate[full] ** 2).mean(), rel=0.05)
    assert top < 0.97
