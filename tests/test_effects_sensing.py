"""Sensing effects against their definitions, and the models to which they apply."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve

from swimid.effects import sensing
from swimid.fitting import drives
from swimid.fitting.model import CruiseInput, RigInput, SurgeInput, SwimInput, Trial
from swimid.propulsion.model import SPEED, RecoilModel, SurgeModel
from swimid.rig import model as rig
from swimid.robots import file as robot_format
from swimid.swimmer.planar.model import MultilinkModel
from tests import effect_cases

SCALE, TURN, LATE = sensing.CameraScale(), sensing.CameraRotation(), sensing.TimeOffset()
LOST, OFF = sensing.MarkerDropout(), sensing.MarkerOffset()
TILT, BIAS = sensing.ImuTilt(), sensing.ImuBias()
RATE = sensing.ClockRate()
EFFECTS = [SCALE, TURN, LATE, RATE, LOST, OFF, TILT, BIAS]
POSE = (0.3, -0.2, 0.5)


def starts(model):
    return np.array([p.start for p in model.parameters])


def swimmer(name, *columns):
    model = MultilinkModel(robot_format.read(name))
    time = np.arange(0.0, 1.61, 0.04)
    beat = drives.TailBeat("sine", 1.5, 0.35, bias_rad=0.1)
    measured = {n: np.zeros(len(time)) for n in columns or model.pose}
    return model, Trial("f", "fit", time, measured, swim=SwimInput(beat, pose=POSE))


@pytest.fixture(scope="module")
def fish():
    return swimmer("tfish", "x_m", "y_m", "yaw_rad", "u_m_s", "v_m_s", "yaw_rate_rad_s")


@pytest.fixture(scope="module")
def dolphin():
    return swimmer("dolphin")


def weight():
    model = rig.falling_weight(mass_kg=1.2, force_N=0.1, area_known=False, pulley=True)
    time = np.linspace(0.1, 5, 30)
    known = RigInput(inertia=1.3, force=0.1, pulley=True, release_s=0.0, x0=0.25)
    return model, Trial("w", "fit", time, {"x_m": time}, rig=known)


def roll():
    model = rig.free_decay("roll_rad", inertia=1.0, stiffness=None, guess=4.0, amplitude=0.3)
    time = np.linspace(0, 5, 60)
    return model, Trial("r", "fit", time, {"roll_rad": time}, rig=RigInput(inertia=1.0, x0=0.3))


def cruise():
    model = RecoilModel(drag_area_kg_m=2.45, moving_mass_kg=1.881, fins={"rect": 1.27e-4})
    inputs = {
        "frequency_hz": np.array([1.5, 2.0, 3.0]),
        "amplitude_rad": np.full(3, 0.28),
        "distance_m": np.array([1.15, 1.15, 0.6]),
    }
    fin = CruiseInput(fin="rect", inertia_kg_m2=1.27e-4, middle=(2.5, 0.2))
    return model, Trial("rect", "fit", np.arange(3.0), {SPEED: np.full(3, 0.1)}, inputs, cruise=fin)


def surge():
    model = SurgeModel(amplitudes_rad=[0.3], frequencies_hz=[1.0], speed_m_s=0.2)
    surge = SurgeInput(amplitude_rad=0.3, frequency_hz=1.0, start_s=0.0)
    return model, Trial("s", "fit", np.arange(9.0), {"u_m_s": np.ones(9)}, surge=surge)


def black_box(output):
    model = effect_cases.arx_model({"a1": -0.9, "b1": 0.3}, 0.1, output=output)
    time = np.arange(60) * 0.1
    return model, Trial("a", "fit", time, {output: np.zeros(60)}, inputs={"cmd1_rad": np.sin(3 * time)})


def seen(case, effect, *values):
    """Return the channels of the log without and with the effect."""
    model, trial = case
    both = model.with_effects([effect], [trial])
    return model.simulate(starts(model), trial), both.run(
        np.concatenate([starts(model), np.array(values)]), trial
    )


def names(case):
    model, trial = case
    return {e.name for e in EFFECTS if e.variants(model, [trial])}


class TestWhereTheyApply:
    def test_swimmers(self, fish, dolphin):
        every = {e.name for e in EFFECTS} - {"marker-dropout"}
        assert names(fish) == every
        assert names(dolphin) == every - {"imu-tilt", "imu-bias"}
        model, trial = fish
        gyro = replace(trial, measured={"yaw_rate_rad_s": trial.time_s})
        assert names((model, gyro)) == {"time-offset", "clock-rate", "imu-tilt", "imu-bias"}
        empty = replace(trial, measured={"yaw_rate_rad_s": np.full(len(trial.time_s), np.nan)})
        assert names((model, empty)) == {"time-offset", "clock-rate"}

    def test_other_models(self):
        assert names(weight()) == {"camera-scale", "time-offset", "clock-rate"}
        assert names(roll()) == {"time-offset", "clock-rate"}
        assert names(cruise()) == {"camera-scale", "time-offset"}
        assert names(surge()) == {"camera-scale"}
        assert names(black_box("u_m_s")) == {"camera-scale", "time-offset", "clock-rate"}
        assert names(black_box("yaw_rate_rad_s")) == {"time-offset", "clock-rate", "imu-tilt", "imu-bias"}
        assert names(black_box("depth")) == {"time-offset", "clock-rate"}

    def test_not_where_the_model_estimates_it(self):
        model, trial = swimmer("tfish")
        model.parameters = tuple(
            replace(p, free=p.free or p.name in ("clock_offset", "camera_rotation")) for p in model.parameters
        )
        assert names((model, trial)) == {"camera-scale", "clock-rate", "marker-offset"}


@pytest.mark.parametrize("effect", EFFECTS, ids=repr)
def test_sensing_changes_nothing_only_at_its_start_values(effect, fish):
    for case in (fish, weight(), cruise(), surge(), black_box("u_m_s"), black_box("yaw_rate_rad_s")):
        model, trial = case
        for variant in effect.variants(model, [trial]):
            own = variant.parameters(model, [trial])
            null = np.array([p.start for p in own])
            nominal, found = seen(case, variant, *null)
            for name, values in found.items():
                np.testing.assert_array_equal(values, nominal[name])
            hooks = variant.hooks(null, trial, model)
            for name, values in model.simulate_hooked(starts(model), trial, hooks).items():
                np.testing.assert_array_equal(values, nominal[name])
            for point in variant.tries(own):
                assert all(p.lower <= v <= p.upper for p, v in zip(own, point, strict=True))
                _, moved = seen(case, variant, *point)
                assert any(np.nanmax(np.abs(moved[n] - nominal[n])) > 0 for n in nominal)


def test_lost_markers_apply_to_no_model(fish):
    model, trial = fish
    assert LOST.variants(model, [trial]) == []
    assert LOST.parameters(model, [trial]) == ()
    assert not LOST.hooks(np.zeros(0), trial, model).output


class TestCamera:
    def test_scale_is_about_the_start(self, fish):
        plain, found = seen(fish, SCALE, 0.1)
        np.testing.assert_allclose(found["x_m"] - POSE[0], 1.1 * (plain["x_m"] - POSE[0]), atol=1e-15)
        np.testing.assert_allclose(found["y_m"] - POSE[1], 1.1 * (plain["y_m"] - POSE[1]), atol=1e-15)
        np.testing.assert_allclose(found["u_m_s"], 1.1 * plain["u_m_s"], rtol=1e-12)
        for name in ("yaw_rad", "yaw_rate_rad_s", "joint4_rad"):
            np.testing.assert_array_equal(found[name], plain[name])

    def test_scale_that_changes_towards_the_edge(self, fish):
        """Two bodies at known places are seen through a lens, one of them at the start of the trial."""
        model, trial = fish
        lens = next(v for v in SCALE.variants(model, [trial]) if v is not SCALE)
        centre, error, bent = complex(0.2, -0.3), 0.07, -0.02
        plain, found = seen(fish, lens, error, bent, centre.real, centre.imag)

        def through(place):
            off = place - centre
            return centre + (1 + error) * off * (1 + bent * abs(off) ** 2)

        begin = complex(*POSE[:2])

        def missed(place):
            off = through(complex(*place)) - begin
            return off.real, off.imag

        there = complex(*fsolve(missed, POSE[:2], xtol=1e-11))
        places = there - begin + plain["x_m"] + 1j * plain["y_m"]
        np.testing.assert_allclose(found["x_m"] + 1j * found["y_m"], through(places), atol=1e-10)
        np.testing.assert_allclose(found["u_m_s"], (1 + error) * plain["u_m_s"], rtol=1e-12)

    def test_scale_in_the_vertical_plane(self, dolphin):
        plain, found = seen(dolphin, SCALE, -0.05)
        np.testing.assert_allclose(found["z_m"] - POSE[1], 0.95 * (plain["z_m"] - POSE[1]), atol=1e-15)

    def test_scale_on_a_rig_and_a_course(self):
        plain, found = seen(weight(), SCALE, 0.1)
        np.testing.assert_allclose(found["x_m"] - 0.25, 1.1 * (plain["x_m"] - 0.25), rtol=1e-12)
        plain, found = seen(cruise(), SCALE, 0.1)
        np.testing.assert_allclose(found[SPEED], 1.1 * plain[SPEED], rtol=1e-12)

    @pytest.mark.parametrize("case", ["fish", "dolphin"])
    def test_rotation_turns_positions_alone(self, case, request):
        case = request.getfixturevalue(case)
        first, second, heading = case[0].pose
        plain, found = seen(case, TURN, 0.4)
        before, after = ((c[first] - POSE[0]) + 1j * (c[second] - POSE[1]) for c in (plain, found))
        np.testing.assert_allclose(after, np.exp(0.4j) * before, atol=1e-14)
        np.testing.assert_array_equal(found[heading], plain[heading])

    def test_rotation_is_that_of_the_model(self, fish):
        model, trial = fish
        values = starts(model)
        values[model.index("camera_rotation")] = 0.2
        own = model.simulate(values, trial)
        _, found = seen(fish, TURN, 0.2)
        for name, expected in own.items():
            np.testing.assert_allclose(found[name], expected, atol=1e-12)


class TestMarkers:
    def test_tracked_point_is_fixed_to_the_body(self, fish):
        """The point keeps its place in the axes of the body, and has the velocity of its motion."""
        model, trial = fish
        fine = replace(
            trial, time_s=np.arange(0.0, 1.6, 0.0005), measured={n: np.arange(3200.0) for n in trial.measured}
        )
        plain, found = seen((model, fine), OFF, 0.05, -0.02, 0.0)
        yaw = plain["yaw_rad"]
        moved = (found["x_m"] - plain["x_m"]) + 1j * (found["y_m"] - plain["y_m"])
        place = moved * np.exp(-1j * yaw)
        np.testing.assert_allclose(
            place + (0.05 - 0.02j) * np.exp(1j * (yaw[0] - yaw)), 0.05 - 0.02j, atol=1e-12
        )
        speed = np.gradient(found["x_m"] + 1j * found["y_m"], fine.time_s) * np.exp(-1j * yaw)
        shown = found["u_m_s"] + 1j * found["v_m_s"]
        np.testing.assert_allclose(shown[2:-2], speed[2:-2], atol=2e-5)
        np.testing.assert_array_equal(found["yaw_rate_rad_s"], plain["yaw_rate_rad_s"])

    def test_misaligned_markers(self, fish):
        plain, found = seen(fish, OFF, 0.0, 0.0, 0.1)
        np.testing.assert_allclose(found["yaw_rad"], plain["yaw_rad"] + 0.1, rtol=1e-14)
        np.testing.assert_array_equal(found["x_m"], plain["x_m"])
        before, after = (c["u_m_s"] + 1j * c["v_m_s"] for c in (plain, found))
        np.testing.assert_allclose(after, before * np.exp(-0.1j), atol=1e-15)


class TestClock:
    def test_late_log_of_a_swimmer(self, fish):
        """The log shows the state two samples earlier."""
        plain, found = seen(fish, LATE, 0.08)
        for name in plain:
            np.testing.assert_allclose(found[name][2:], plain[name][:-2], atol=1e-9)

    def test_early_log_of_a_rig(self):
        model, trial = weight()
        _, found = seen((model, trial), LATE, -0.4)
        later = model.simulate(starts(model), replace(trial, time_s=trial.time_s + 0.4))
        np.testing.assert_allclose(found["x_m"], later["x_m"], atol=1e-9)

    def test_timed_runs_take_longer(self):
        plain, found = seen(cruise(), LATE, 0.3)
        distance = np.array([1.15, 1.15, 0.6])
        np.testing.assert_allclose(distance / found[SPEED], distance / plain[SPEED] + 0.3, rtol=1e-12)


class TestGyroscope:
    def test_tilt_and_bias(self, fish):
        plain, found = seen(fish, TILT, 0.5)
        np.testing.assert_allclose(
            found["yaw_rate_rad_s"], math.cos(0.5) * plain["yaw_rate_rad_s"], rtol=1e-14
        )
        plain, found = seen(fish, BIAS, -0.03)
        np.testing.assert_allclose(found["yaw_rate_rad_s"], plain["yaw_rate_rad_s"] - 0.03, atol=1e-15)
        for name in set(plain) - {"yaw_rate_rad_s"}:
            np.testing.assert_array_equal(found[name], plain[name])


def test_the_cameras_clock_alone() -> None:
    """Poses are late and the gyroscope is not; before the first sample the robot rests."""
    model = effect_cases.swimmer("tfish")
    trial = effect_cases.swim(model)
    variants = sensing.TimeOffset().variants(model, [trial])
    assert [v.camera for v in variants] == [False, True]  # type: ignore[attr-defined]
    seen = effect_cases.acted(model, trial, [(variants[1], 0.1)])
    plain, late = (
        model.simulate(effect_cases.start(model), trial),
        effect_cases.acted(model, trial, [(variants[0], 0.1)]),
    )
    for name in ("x_m", "y_m", "yaw_rad"):
        np.testing.assert_allclose(seen[name], late[name], atol=2e-4)
    np.testing.assert_array_equal(seen["yaw_rate_rad_s"], plain["yaw_rate_rad_s"])


def test_a_broken_simulation_stays_missing_under_a_late_camera(fish):
    """A simulation that diverged shows nothing, and does not stop the comparison."""
    model, trial = fish
    late = next(v for v in LATE.variants(model, [trial]) if v.camera)
    hooks = late.hooks(np.array([0.02]), trial, model)
    time = trial.time_s
    broken = np.where(time > time[len(time) // 2], np.inf, 0.0)
    found = hooks.sense({"x_m": broken, "y_m": np.sin(time), "u_m_s": time}, time)
    assert np.isnan(found["x_m"]).all()
    assert np.isfinite(found["y_m"]).all()
    np.testing.assert_array_equal(found["u_m_s"], time)


# ---------------------------------------------------------------- clocks that run fast


def shown(model, trial, effect, value):
    return model.simulate_hooked(starts(model), trial, effect.hooks(np.array([value]), trial, model))


@pytest.mark.parametrize("rate", [0.05, -0.05])
def test_a_fast_clock_shows_earlier_states(fish, rate):
    """A slow clock shows later states, also after the last sample."""
    model, trial = fish
    seen = shown(model, trial, RATE, rate)
    expected = model.simulate(starts(model), replace(trial, time_s=trial.time_s / (1 + rate)))
    for name in model.pose:
        # the integration steps differ, and samples lie between them
        np.testing.assert_allclose(seen[name], expected[name], atol=2e-6)


def test_a_fast_clock_agrees_with_the_drive_where_that_begins():
    """On a rig this is the release, and for a recorded input its first sample."""
    known = RigInput(1.2, 0.2, pulley=True, release_s=1.0)
    time = np.linspace(0.0, 4.0, 101)
    weight = effect_cases.weight_model()
    trial = Trial("w", "fit", time, {"x_m": time}, rig=known)
    fallen = np.maximum(time - 1.0, 0.0) / 1.02
    np.testing.assert_allclose(
        shown(weight, trial, RATE, 0.02)["x_m"], 0.5 * 0.2 / 1.2 * fallen**2, atol=1e-12
    )
    model = effect_cases.arx_model({"a1": -1.5, "a2": 0.7, "b1": 0.5, "b2": 0.25}, 0.05)
    time = 7.0 + np.arange(200) * 0.05
    source = np.sin(0.8 * time)
    run = Trial("a", "fit", time, {"u_m_s": np.zeros(200)}, inputs={"cmd1_rad": source})
    plain = model.simulate(starts(model), run)["u_m_s"]
    then = 7.0 + (time - 7.0) / 1.02
    np.testing.assert_allclose(shown(model, run, RATE, 0.02)["u_m_s"], np.interp(then, time, plain))


def test_no_offset_imitates_a_fast_clock(fish):
    """The changes by both are not proportional in any channel of a pose."""
    model, trial = fish
    plain = model.simulate(starts(model), trial)
    fast, late = shown(model, trial, RATE, 0.01), shown(model, trial, LATE, 0.01)
    for name in model.pose:
        one, other = fast[name] - plain[name], late[name] - plain[name]
        assert abs(one @ other) < 0.97 * np.linalg.norm(one) * np.linalg.norm(other)


def test_a_camera_alone_runs_fast(fish):
    model, trial = fish
    whole, camera = RATE.variants(model, [trial])
    assert (whole.camera, camera.camera) == (False, True)
    (parameter,) = camera.parameters(model, [trial])
    assert parameter.name == "camera_rate"
    fast = {e.camera: shown(model, trial, e, 0.02) for e in (whole, camera)}
    plain = model.simulate(starts(model), trial)
    # the fast clock interpolates samples, the other simulates between them
    for name in model.pose:
        np.testing.assert_allclose(fast[True][name], fast[False][name], atol=2e-4)
    np.testing.assert_array_equal(fast[True]["yaw_rate_rad_s"], plain["yaw_rate_rad_s"])


def test_the_camera_has_its_own_clock_beside_joint_angles():
    model, trial = swimmer("tfish", "x_m", "y_m", "yaw_rad", "joint1_rad")
    for effect in (RATE, LATE):
        assert [e.camera for e in effect.variants(model, [trial])] == [False, True]
    fast = shown(model, trial, RATE.variants(model, [trial])[1], 0.02)
    plain = model.simulate(starts(model), trial)
    np.testing.assert_array_equal(fast["joint1_rad"], plain["joint1_rad"])
    assert np.max(np.abs(fast["yaw_rad"] - plain["yaw_rad"])) > 0.01
    pose_only = replace(trial, measured={name: trial.measured[name] for name in model.pose})
    assert [e.camera for e in RATE.variants(model, [pose_only])] == [False]
    driven = replace(trial, swim=SwimInput(joints=[drives.straight] * 3, pose=POSE))
    assert [e.camera for e in RATE.variants(model, [driven])] == [False]


def test_an_averaged_beat_has_no_clock_that_drifts():
    surge = SurgeModel(amplitudes_rad=[0.2], frequencies_hz=[1.0], speed_m_s=0.2)
    cruise = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4})
    assert not RATE.variants(surge, [])
    assert not RATE.variants(cruise, [])
