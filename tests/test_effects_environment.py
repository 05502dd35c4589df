"""Effects of the surroundings against closed forms and identities."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swimid.effects.base import Effect
from swimid.effects.environment import (
    Buoyancy,
    Current,
    SurfaceBreach,
    Tether,
    Wall,
    Waves,
    _Travelling,
    find_lines,
    pull_back,
    push_off,
    rise,
    sink,
)
from swimid.effects.rig import InitialSpeed
from swimid.fitting.drives import TailBeat
from swimid.fitting.model import CruiseInput, RigInput, SwimInput, Trial
from swimid.propulsion.model import RecoilModel
from swimid.rig import model as rig
from swimid.robots import file as robots
from swimid.robots.planar import PlanarForce
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
from tests.toy_models import Toy

ALL = [Buoyancy(), Current(), SurfaceBreach(), Tether(), Wall(), Waves()]


@pytest.mark.parametrize("robot", ["tfish", "dolphin"])
@pytest.mark.parametrize("effect", ALL, ids=lambda e: e.name)
def test_null_and_tries_of_swimmers(effect: Effect, robot: str) -> None:
    model = swimmer(robot)
    trial = swim(model)
    rocked = {n: v + 1e-3 * np.sin(4.0 * trial.time_s) for n, v in trial.measured.items() if n.endswith("_m")}
    trial = replace(trial, measured={**trial.measured, **rocked})
    if robot == "tfish" and effect.name in ("buoyancy", "surface-breach"):
        assert not effect.variants(model, [trial])
    else:
        check_null(model, trial, effect)


@pytest.mark.parametrize("effect", [Current(), Tether(), Wall(), Waves()], ids=lambda e: e.name)
def test_null_and_tries_of_rigs(effect: Effect) -> None:
    check_null(weight_model(quadratic_drag=2.0, added_mass=0.4), weight_trial(), effect)


@pytest.mark.parametrize("effect", ALL, ids=lambda e: e.name)
def test_currents_and_waves_do_not_apply_to_a_roll(effect: Effect) -> None:
    model = rig.free_decay("roll_rad", inertia=0.01, stiffness=1.0, guess=1.0, amplitude=0.3)
    trial = Trial("d", "fit", TIME, {"roll_rad": np.cos(TIME)}, rig=RigInput(inertia=0.01, x0=0.3))
    assert not effect.variants(model, [trial])


# ------------------------------------------------------------ water that moves


def test_current_is_a_galilean_shift() -> None:
    model = swimmer("tfish")
    current, heading = np.array([0.05, -0.08]), 0.7
    trial = swim(model, pose=(0.3, -0.2, heading))
    seen = acted(model, trial, [(Current(), current)])
    c, s = np.cos(heading), np.sin(heading)
    values = start(
        model,
        initial_surge=-(c * current[0] + s * current[1]),
        initial_sway=-(c * current[1] - s * current[0]),
    )
    relative = model.simulate(values, trial)
    np.testing.assert_allclose(seen["x_m"], relative["x_m"] + current[0] * trial.time_s, atol=1e-9)
    np.testing.assert_allclose(seen["y_m"], relative["y_m"] + current[1] * trial.time_s, atol=1e-9)
    np.testing.assert_allclose(seen["yaw_rad"], relative["yaw_rad"], atol=1e-10)


def test_a_body_on_a_rig_drifts_with_current_and_waves() -> None:
    a, b, f = 0.12, -0.07, 0.8
    effects: list[tuple[Effect, Any]] = [(Current(), 0.1), (Waves("x", f), (f, a, b)), (InitialSpeed(), 0.1)]
    seen = acted(weight_model(quadratic_drag=3.0), weight_trial(force=0.0), effects)
    w = 2 * np.pi * f
    expected = 0.1 * TIME + (a * (np.sin(w * TIME) + np.exp(-w * TIME) - 1) + b * (1 - np.cos(w * TIME))) / w
    np.testing.assert_allclose(seen["x_m"], expected, atol=2e-4)


@pytest.mark.parametrize("robot", ["tfish", "dolphin"])
def test_a_wave_may_differ_from_place_to_place(robot: str) -> None:
    """A robot swims at 0.4 m/s through a standing wave that has a node at its first place."""
    model = swimmer(robot)
    time = np.arange(0.0, 8.0, 0.04)
    across = model.axes[1]
    measured = {"x_m": 0.7 + 0.4 * time, f"{across}_m": 0.2 * time}
    trial = replace(swim(model), time_s=time, measured=measured)
    wave = _Travelling("x", 0.5)
    assert any(isinstance(e, _Travelling) for e in Waves().variants(model, [trial]))
    toward = 0.3 if across == "y" else 0.0
    values = {
        "frequency_hz": 0.5,
        "wavenumber_rad_m": 1.1,
        "direction_rad": toward,
        "cos_x_quarter_m_s": 0.03,
    }
    names = [p.name for p in wave.parameters(model, [trial])]
    (flow,) = wave.hooks(np.array([values.get(n, 0.0) for n in names]), trial, model).flow
    fine = np.linspace(0.0, 7.9, 4001)
    moved, speed = flow(fine)
    place = (0.7 + 0.4 * fine) * np.cos(toward) + 0.2 * fine * np.sin(toward)
    phase = np.pi * fine
    expected = 0.03 * np.sin(1.1 * place) * (np.cos(phase) - np.exp(-phase))
    np.testing.assert_allclose(speed[:, 0], expected * np.cos(toward), atol=2e-5)
    np.testing.assert_allclose(speed[:, 1], expected * np.sin(toward), atol=2e-5)
    np.testing.assert_allclose(np.gradient(moved, fine, axis=0)[2:-2], speed[2:-2], atol=1e-6)


def test_current_carries_a_cruise() -> None:
    model = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4})
    inputs = {name: np.full(2, v) for name, v in (("frequency_hz", 2.0), ("amplitude_rad", 0.4))}
    inputs["distance_m"] = np.array([0.5, 1.0])
    cruise = CruiseInput(fin="a", inertia_kg_m2=1e-4, middle=(2.0, 0.4))
    trial = Trial("a", "fit", np.arange(2.0), {}, inputs=inputs, cruise=cruise)
    plain = model.simulate(start(model), trial)["mean_speed_m_s"]
    seen = acted(model, trial, [(Current(), 0.02)])["mean_speed_m_s"]
    np.testing.assert_allclose(seen, plain + 0.02, rtol=1e-12)


def test_lines_of_a_track_are_found_beside_the_beat() -> None:
    rng = np.random.default_rng(3)
    trials = []
    for beat in (0.9, 1.2):
        time = np.arange(0.0, 12.0, 0.04)
        track = 0.2 * time + 0.01 * time**2 + 0.02 * np.sin(2 * np.pi * beat * time)
        track += 0.004 * np.cos(2 * np.pi * 0.63 * time + rng.uniform(0, 6))
        track += 1e-3 * rng.standard_normal(len(time))
        swim = SwimInput(TailBeat("sine", beat, 0.3))
        trials.append(Trial(str(beat), "fit", time, {"x_m": track}, swim=swim))
    model = Toy(lambda values, time: {"x_m": np.full(len(time), 0.2)}, (), ("x_m",))
    assert find_lines(model, trials, "x")[0] == pytest.approx(0.63, abs=0.05)
    assert find_lines(model, trials, "y") == ()


def test_oscillations_of_the_model_are_no_waves() -> None:
    time = np.arange(0.0, 12.0, 0.04)
    own = {"x_m": 0.01 * np.sin(2 * np.pi * 0.4 * time)}
    model = Toy(lambda values, time: own, (), ("x_m",))
    trial = Trial("a", "fit", time, {"x_m": own["x_m"] + 1e-3 * np.sin(2 * np.pi * 0.9 * time)})
    assert find_lines(model, [trial], "x")[0] == pytest.approx(0.9, abs=0.05)


# ------------------------------------------------------------ forces


def test_a_tether_is_a_spring() -> None:
    k = 5.0
    seen = acted(weight_model(), weight_trial(force=0.0), [(Tether(), (k, 0.0, 0.0)), (InitialSpeed(), 0.2)])
    rate = np.sqrt(k / INERTIA)
    np.testing.assert_allclose(seen["x_m"], 0.2 / rate * np.sin(rate * TIME), atol=1e-7)


def test_a_slack_tether_pulls_only_beyond_its_slack() -> None:
    k, slack = 5.0, 0.3
    seen = acted(
        weight_model(), weight_trial(force=0.0), [(Tether(), (k, slack, 0.0)), (InitialSpeed(), 0.2)]
    )
    free = TIME < 1.5
    np.testing.assert_allclose(seen["x_m"][free], 0.2 * TIME[free], atol=1e-12)
    energy = 0.5 * INERTIA * seen["u_m_s"] ** 2 + 0.5 * k * np.maximum(seen["x_m"] - slack, 0) ** 2
    np.testing.assert_allclose(energy, 0.5 * INERTIA * 0.04, rtol=1e-3)


def test_a_tether_pulls_to_its_anchor_at_any_heading() -> None:
    wrench = np.zeros(3)
    pull_back._pyfunc(
        0.0, np.array([1.3, 2.4, 0.5]), np.zeros(3), np.array([2.0, 0.1, 0.0, 1.0, 2.0]), wrench
    )
    c, s = np.cos(0.5), np.sin(0.5)
    world = np.array([c * wrench[0] - s * wrench[1], s * wrench[0] + c * wrench[1]])
    np.testing.assert_allclose(world, -2.0 * (0.5 - 0.1) * np.array([0.6, 0.8]), rtol=1e-12)


def test_an_anchor_behind_the_start_pulls_from_the_begin() -> None:
    """A robot that coasts along its heading swings about the anchor."""
    model = dry_fish()
    mass, k, behind = 2.133 + 3 * 0.081 + 0.096, 30.0, 0.4
    seen = acted(model, coasting(model), [(Tether(), (k, 0.0, 0.0, behind))], initial_surge=0.3)
    rate, time = np.sqrt(k / mass), coasting(model).time_s
    swing = behind * (np.cos(rate * time) - 1.0) + 0.3 / rate * np.sin(rate * time)
    np.testing.assert_allclose(seen["x_m"], swing, atol=1e-7)


def test_the_line_of_a_tether_has_drag() -> None:
    c, v0 = 2.0, 0.2
    seen = acted(weight_model(), weight_trial(force=0.0), [(Tether(), (0.0, 0.0, c)), (InitialSpeed(), v0)])
    # M v dv/dx = -c x v^2
    expected = v0 * np.exp(-0.5 * c * seen["x_m"] ** 2 / INERTIA)
    np.testing.assert_allclose(seen["u_m_s"], expected, rtol=1e-5)


def test_a_tether_takes_its_work_from_a_cruise() -> None:
    model = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4})
    trial = Trial("a", "fit", np.arange(1.0), {}, inputs={"distance_m": np.array([2.0])})
    c = {"dry": 0.0}
    Tether().hooks(np.array([0.3, 0.5]), trial, model).change_values(c, "coefficients")
    assert c["dry"] * 2.0 == pytest.approx(0.5 * 0.3 * 1.5**2)


def test_blockage_before_a_wall_in_closed_form() -> None:
    drag, gain, decay, end, v0 = 2.0, 3.0, 0.1, 0.5, 0.17
    seen = acted(
        weight_model(quadratic_drag=drag),
        weight_trial(force=0.0),
        [(Wall("x_max", end), (gain, decay)), (InitialSpeed(), v0)],
    )
    x = seen["x_m"]
    assert 0.3 < x[-1] < end
    grown = gain * decay * (np.exp(-(end - x) / decay) - np.exp(-end / decay))
    np.testing.assert_allclose(seen["u_m_s"], v0 * np.exp(-drag / INERTIA * (x + grown)), rtol=1e-6)


@pytest.mark.parametrize("outwards", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_the_push_of_a_wall_decays_with_distance(outwards: tuple[int, int]) -> None:
    """The force is proportional to the squared speed, in whatever direction the hull moves."""

    def push(distance: float, speed: float = 1.0) -> np.ndarray:
        wrench, heading = np.zeros(3), 0.8
        velocity = speed * np.array([0.8, 0.6, 0.0])
        place = (2.0 - distance) * np.array(outwards, dtype=float)
        constants = np.array([0.3, 0.25, *outwards, 2.0])
        push_off._pyfunc(0.0, np.array([*place, heading]), velocity, constants, wrench)
        c, s = np.cos(heading), np.sin(heading)
        return np.array([c * wrench[0] - s * wrench[1], s * wrench[0] + c * wrench[1]])

    np.testing.assert_allclose(push(0.0), -0.3 * np.array(outwards), atol=1e-12)
    np.testing.assert_allclose(push(0.5), -0.3 * np.exp(-2.0) * np.array(outwards), atol=1e-12)
    np.testing.assert_allclose(push(0.5, 0.2), 0.04 * push(0.5), atol=1e-12)
    np.testing.assert_array_equal(push(0.5, 0.0), np.zeros(2))


def test_a_wall_is_tried_as_a_push_and_as_a_pull() -> None:
    model = swimmer("tfish")
    trial = swim(model)
    for wall in Wall().variants(model, [trial]):
        signs = [np.sign(point[0]) for point in wall.tries(wall.parameters(model, [trial]))]
        assert sorted(signs) == [-1.0, -1.0, 1.0, 1.0]
    rig_wall = Wall("x_max", 0.5)
    points = rig_wall.tries(rig_wall.parameters(weight_model(), [weight_trial()]))
    assert all(point[0] > 0.0 for point in points)
    assert len(points) == 2


def test_walls_are_at_the_extremes_of_the_tracks() -> None:
    model = swimmer("tfish")
    trial = swim(model)
    found = {wall.side: wall.extreme_m for wall in Wall().variants(model, [trial])}  # type: ignore[attr-defined]
    assert found["x_max"] == trial.measured["x_m"].max()
    assert found["y_min"] == trial.measured["y_m"].min()
    assert len(found) == 4


def test_a_hull_above_the_surface_loses_buoyancy() -> None:
    wrench = np.zeros(3)
    sink._pyfunc(0.0, np.array([0.0, 0.5, 0.3]), np.zeros(3), np.array([40.0, 0.4, 0.0, 0.0, 0.0]), wrench)
    world = np.sin(0.3) * wrench[0] + np.cos(0.3) * wrench[1]
    assert world == pytest.approx(-4.0, rel=1e-3)
    wrench[:] = 0.0
    sink._pyfunc(0.0, np.array([0.0, 0.5, 0.3]), np.zeros(3), np.array([40.0, 0.4, -0.2, 0.1, 0.0]), wrench)
    world = np.sin(0.3) * wrench[0] + np.cos(0.3) * wrench[1]
    assert wrench[2] == 0.0
    assert world == pytest.approx(-40.0 * (0.1 - 0.2 * np.sin(0.3) + 0.1 * np.cos(0.3)), rel=1e-3)
    wrench[:] = 0.0
    sink._pyfunc(0.0, np.array([0.0, 0.3, 0.3]), np.zeros(3), np.array([40.0, 0.4, 0.0, 0.0, 0.0]), wrench)
    assert np.abs(wrench).max() < 1e-3
    # half of the force pulls down the end that is above the surface
    sink._pyfunc(0.0, np.array([0.0, 0.4, 0.3]), np.zeros(3), np.array([40.0, 0.4, 0.0, 0.0, 0.2]), wrench)
    out = 0.2 * np.sin(0.3)
    assert np.hypot(wrench[0], wrench[1]) == pytest.approx(20.0 * out, rel=2e-2)
    assert wrench[2] == pytest.approx(-20.0 * out * 0.2 * np.cos(0.3), rel=2e-2)


def test_buoyancy_is_a_force_of_the_robot_file() -> None:
    def lifted(body: Any) -> None:
        body.elements.append(
            PlanarForce(kind="force", name="lift", link="trunk", at_m=0.14631, port_N=0.05, frame="world")
        )

    model, built = swimmer("dolphin"), changed(robots.read("dolphin"), lifted)
    trial = swim(model, pose=(0.0, 0.0, 0.2))
    seen, expected = acted(model, trial, [(Buoyancy(), (0.05, 0.0))]), built.simulate(start(built), trial)
    for name in ("x_m", "z_m", "pitch_rad"):
        np.testing.assert_allclose(seen[name], expected[name], atol=1e-9)


def test_the_righting_moment_levels_the_body() -> None:
    wrench = np.zeros(3)
    rise._pyfunc(0.0, np.array([0.0, 0.0, 0.3]), np.zeros(3), np.array([0.0, 2.0]), wrench)
    np.testing.assert_allclose(wrench, [0.0, 0.0, -2.0 * np.sin(0.3)])
