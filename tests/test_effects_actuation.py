"""Actuation effects against closed forms, and the average models on which they and others act."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from swimid.effects import actuation
from swimid.fitting import drives
from swimid.fitting.model import CruiseInput, Hooks, Stroke, SurgeInput, SwimInput, Trial
from swimid.propulsion.model import SPEED, RecoilModel, SurgeModel, velocity_ratio
from swimid.robots import file as robot_format
from swimid.swimmer.planar.model import MultilinkModel
from tests import effect_cases

EFFECTS = [
    actuation.ServoLag(),
    actuation.ServoDelay(),
    actuation.ServoBacklash(),
    actuation.AmplitudeLoss(),
    actuation.RateLimit(),
    actuation.AmplitudeOffset(),
]
TIME = np.arange(0.0, 8.0, 0.0025)
OMEGA = 2 * np.pi * 1.5
DRAG_AREA, MASS = 2.45, 1.881


def recoil():
    model = RecoilModel(drag_area_kg_m=DRAG_AREA, moving_mass_kg=MASS, fins={"rect": 1.27e-4})
    # the offset is known, so that another one is an effect
    model.parameters = tuple(
        replace(p, free=False) if p.name == "amplitude_offset_deg" else p for p in model.parameters
    )
    inputs = {
        "frequency_hz": np.array([1.5, 2.0, 2.5, 3.0, 3.5]),
        "amplitude_rad": np.deg2rad([16.0, 16.0, 12.0, 16.0, 10.0]),
        "distance_m": np.array([1.15, 1.15, 1.15, 1.0, 0.5]),
    }
    trial = Trial(
        "rect",
        "fit",
        np.arange(5.0),
        {SPEED: np.full(5, 0.1)},
        inputs=inputs,
        cruise=CruiseInput(fin="rect", inertia_kg_m2=1.27e-4, middle=(2.5, 0.2)),
        value_sd={SPEED: np.arange(1.0, 6.0)},
    )
    return model, trial


def surge():
    model = SurgeModel(amplitudes_rad=[0.2, 0.35], frequencies_hz=[1.0, 2.0], speed_m_s=0.2)
    surge = SurgeInput(amplitude_rad=0.3, frequency_hz=1.5, start_s=0.3)
    return model, Trial("s", "fit", 0.3 + np.arange(12) / 1.5, {"u_m_s": np.full(12, 0.1)}, surge=surge)


def black_box(source=None):
    model = effect_cases.arx_model({"a1": -1.5, "a2": 0.7, "b1": 0.5, "b2": 0.25}, 0.05)
    time = np.arange(200) * 0.05
    column = 0.4 * np.sin(2 * np.pi * 0.8 * time) if source is None else source
    trial = Trial("a", "fit", time, {"u_m_s": np.zeros(200)}, inputs={"cmd1_rad": column})
    return model, trial


@pytest.fixture(scope="module")
def fish():
    model = MultilinkModel(robot_format.read("tfish"))
    time = np.arange(0.0, 2.51, 0.04)
    swim = SwimInput(drives.TailBeat("sine", 1.5, 0.35), pose=(0.3, -0.2, 0.5))
    return model, Trial("f", "fit", time, dict.fromkeys(model.pose, time), swim=swim)


def starts(model):
    return np.array([p.start for p in model.parameters])


class TestOperators:
    @pytest.mark.parametrize("tau", [0.004, 0.05, 0.3])
    def test_lag_of_a_sine(self, tau):
        """The gain is 1 / (1 + i w tau) after the transient."""
        found = actuation.apply_lag(TIME, np.sin(OMEGA * TIME), tau)
        answer = np.exp(1j * OMEGA * TIME) / (1 + 1j * OMEGA * tau)
        late = 20 * tau < TIME
        np.testing.assert_allclose(found[late], answer.imag[late], atol=1e-4)

    def test_lag_of_a_ramp_on_any_grid(self, rng):
        time = np.sort(rng.uniform(0, 5, 60))
        since = time - time[0]
        expected = 2.0 * (since - 0.4 * -np.expm1(-since / 0.4)) + 1.0
        np.testing.assert_allclose(actuation.apply_lag(time, 1.0 + 2.0 * since, 0.4), expected, atol=1e-12)

    def test_delay(self):
        found = actuation.apply_delay(TIME, np.sin(OMEGA * TIME), 0.0333)
        expected = np.where(TIME < 0.0333, 0.0, np.sin(OMEGA * (TIME - 0.0333)))
        inside = np.abs(TIME - 0.0333) > 0.01
        np.testing.assert_allclose(found[inside], expected[inside], atol=3e-5)

    def test_play(self):
        """The joint rests while the servo crosses the play, then follows half of it behind."""
        width, size = 0.08, 0.3
        signal = size * np.sin(OMEGA * TIME)
        found = actuation.ServoBacklash().follow(width, signal, signal)
        assert found[0] == 0
        assert np.all(np.abs(found - signal) <= 0.5 * width + 1e-15)
        steady = TIME > 1 / 1.5
        assert found[steady].max() == pytest.approx(size - 0.5 * width, abs=1e-4)
        phase = np.mod(OMEGA * TIME, 2 * np.pi)
        crossing = math.acos(1 - width / size)
        flat = steady & (phase > 0.5 * np.pi + 0.02) & (phase < 0.5 * np.pi + crossing - 0.02)
        assert np.ptp(found[flat]) < 1e-4
        falling = steady & (phase > 0.5 * np.pi + crossing + 0.02) & (phase < 1.5 * np.pi - 0.02)
        np.testing.assert_allclose(found[falling], signal[falling] + 0.5 * width, atol=1e-12)

    def test_a_strongly_limited_sine_is_a_triangle(self):
        rate = 0.3 * OMEGA
        found = actuation.limit_rate(TIME, np.sin(OMEGA * TIME), rate)[TIME > 6]
        assert np.abs(np.diff(found)).max() <= rate * 0.0025 * (1 + 1e-9)
        assert 0.5 * np.ptp(found) == pytest.approx(rate / (4 * 1.5), rel=5e-3)

    @pytest.mark.parametrize("ratio", [0.2, 0.5, 0.55, 0.7, 0.85, 0.97])
    def test_describing_function_is_the_fundamental(self, ratio):
        time = np.arange(80_000) / 10_000
        found = actuation.limit_rate(time, np.sin(2 * np.pi * time), 2 * np.pi * ratio)[40_000:]
        fundamental = 2 * abs(np.mean(found * np.exp(-2j * np.pi * time[40_000:])))
        assert float(actuation.compute_fundamental_gain(ratio)) == pytest.approx(fundamental, abs=5e-4)


class TestNull:
    @pytest.mark.parametrize("effect", [*EFFECTS, actuation.Slip()], ids=repr)
    @pytest.mark.parametrize("kind", ["recoil", "surge", "black box", "fish"])
    def test_an_effect_changes_nothing_only_at_its_start_values(self, effect, kind, fish):
        model, trial = {"recoil": recoil, "surge": surge, "black box": black_box, "fish": lambda: fish}[
            kind
        ]()
        variants = effect.variants(model, [trial])
        assert bool(variants) == bool(effect.needs & model.offers)
        for variant in variants:
            both = model.with_effects([variant], [trial])
            null, nominal = starts(both), model.simulate(starts(model), trial)
            for name, values in both.run(null, trial).items():
                np.testing.assert_array_equal(values, nominal[name])
            own = both.acting[0].parameters
            for point in variant.tries(own):
                assert all(p.lower <= v <= p.upper for p, v in zip(own, point, strict=True))
            moved = variant.tries(own)[-1]
            near = np.concatenate([starts(model), starts_of(own) + 1e-7 * (moved - starts_of(own))])
            far = np.concatenate([starts(model), moved])
            close, apart = (both.run(v, trial) for v in (near, far))
            change = {n: np.nanmax(np.abs(apart[n] - nominal[n])) for n in nominal}
            assert max(change.values()) > 0
            for name in nominal:
                assert np.nanmax(np.abs(close[name] - nominal[name])) <= 1e-4 * change[name] + 1e-12


def starts_of(parameters):
    return np.array([p.start for p in parameters])


class TestFish:
    def angles(self, fish, effect, values):
        model, trial = fish
        both = model.with_effects([effect], [trial])
        found = both.run(np.concatenate([starts(model), values]), trial)
        return np.array([found[a.column] for a in model.tree.driven])

    def told(self, fish, time):
        model, trial = fish
        gains = [a.joint.driven.gain for a in model.tree.driven]
        return np.outer(gains, trial.swim.beat.motion(time)[0])

    def test_loss_of_every_joint(self, fish):
        np.testing.assert_allclose(
            self.angles(fish, EFFECTS[3], [0.2]), 0.8 * self.told(fish, fish[1].time_s), atol=1e-4
        )

    def test_delay_of_every_joint(self, fish):
        time = fish[1].time_s - 0.05
        expected = np.where(time > 0, self.told(fish, np.maximum(time, 0)), 0.0)
        found = self.angles(fish, EFFECTS[1], [0.05])
        np.testing.assert_allclose(found[:, :-1], expected[:, :-1], atol=1e-4)

    def test_a_trim_sets_in_smoothly_and_stays(self, fish):
        off = self.angles(fish, EFFECTS[5], [0.03]) - self.told(fish, fish[1].time_s)
        assert np.all(np.abs(off[:, 0]) < 1e-6)
        np.testing.assert_allclose(off[:, fish[1].time_s > 0.55], 0.03, atol=1e-5)

    def test_slip_of_every_joint_begins_at_its_time(self, fish):
        time = fish[1].time_s
        told, found = self.told(fish, time), self.angles(fish, actuation.Slip(), [0.3, 1.6])
        ramp = actuation.RAMP / 1.5
        before, after = time < 1.6 - 0.5 * ramp - 0.03, time > 1.6 + 0.5 * ramp + 0.03
        np.testing.assert_allclose(found[:, before], told[:, before], atol=1e-9)
        np.testing.assert_allclose(found[:, after], 0.7 * told[:, after], atol=2e-4)

    def test_the_time_of_a_slip_has_a_derivative(self, fish):
        """The change to first order is half of that to both sides, also a quarter of the trial away."""
        at = [
            self.angles(fish, actuation.Slip(), [0.3, 1.6 + step]) for step in (-2e-3, -1e-3, 0.0, 1e-3, 2e-3)
        ]
        one, two = (at[3] - at[1]) / 2e-3, (at[4] - at[0]) / 4e-3
        assert np.abs(one).max() > 0.05
        np.testing.assert_allclose(one, two, atol=2e-3 * np.abs(one).max())

    def test_actuation_does_not_change_measured_joints(self, fish):
        model, trial = fish
        joints = [lambda t: (np.sin(t), np.cos(t), -np.sin(t))] * 3
        swim = SwimInput(joints=joints, pose=(0, 0, 0))
        measured = replace(trial, swim=swim)
        told = replace(trial, swim=replace(swim, commanded=True))
        for effect in EFFECTS:
            assert not effect.variants(model, [measured])
            assert effect.variants(model, [told])
            values = np.array([p.scale for p in effect.parameters(model, [trial])])
            assert not effect.hooks(values, measured, model).command


class TestBlackBox:
    def answer(self, effect, values, column=None):
        model, trial = black_box(column)
        return model.simulate_hooked(starts(model), trial, effect.hooks(np.array(values), trial, model))[
            "u_m_s"
        ]

    def test_delay_by_whole_samples_is_a_shift(self, rng):
        """The input starts at rest."""
        column = np.concatenate([np.zeros(20), rng.normal(size=180)])
        model, trial = black_box(column)
        nominal = model.simulate(starts(model), trial)["u_m_s"]
        found = self.answer(EFFECTS[1], [0.15], column)
        np.testing.assert_allclose(found[20:], nominal[17:-3], atol=1e-9)

    def test_loss_is_a_smaller_gain(self):
        model, trial = black_box()
        nominal = model.simulate(starts(model), trial)["u_m_s"]
        np.testing.assert_allclose(self.answer(EFFECTS[3], [0.3]), 0.7 * nominal, atol=1e-12)

    def test_missing_input_stays_missing(self):
        model, trial = black_box()
        column = trial.inputs["cmd1_rad"].copy()
        column[40:44] = np.nan
        holed = replace(trial, inputs={"cmd1_rad": column})
        for effect in EFFECTS:
            (p,) = effect.parameters(model, [holed])
            hooks = effect.hooks(np.array([p.start + (-1 if p.start else 1) * p.scale]), holed, model)
            np.testing.assert_array_equal(
                np.isnan(hooks.actuate(trial.time_s, column)), np.isnan(column), repr(effect)
            )


class TestAverageModels:
    """Effects on strokes, and on a body that strokes drive."""

    def speeds(self, effect, values, nominal=None):
        model, trial = recoil()
        return model.simulate_hooked(
            starts(model) if nominal is None else nominal, trial, effect.hooks(np.array(values), trial, model)
        )[SPEED]

    def with_amplitude(self, change):
        model, trial = recoil()
        told = trial.inputs
        inputs = {**told, "amplitude_rad": change(told["amplitude_rad"], told["frequency_hz"])}
        return model.simulate(starts(model), replace(trial, inputs=inputs))[SPEED]

    @pytest.mark.parametrize(
        "effect, value, change",
        [
            (EFFECTS[0], 0.03, lambda a, f: a / np.sqrt(1 + (2 * np.pi * f * 0.03) ** 2)),
            (EFFECTS[2], 0.04, lambda a, f: a - 0.02),
            (EFFECTS[3], 0.1, lambda a, f: 0.9 * a),
            (EFFECTS[4], 1.0, lambda a, f: np.minimum(4 / np.pi / (2 * np.pi * f), a)),
        ],
        ids=["lag", "backlash", "loss", "limit"],
    )
    def test_strokes_are_smaller(self, effect, value, change):
        np.testing.assert_allclose(self.speeds(effect, [value]), self.with_amplitude(change), rtol=1e-12)

    def test_offset_is_that_of_the_law(self):
        model, trial = recoil()
        values = starts(model)
        values[model.index("amplitude_offset_deg")] += math.degrees(0.03)
        np.testing.assert_allclose(
            self.speeds(EFFECTS[5], [0.03]), model.simulate(values, trial)[SPEED], rtol=1e-12
        )
        free = tuple(replace(p, free=True) for p in model.parameters)
        model.parameters = free
        assert not EFFECTS[5].variants(model, [trial])

    def test_a_factor_on_the_thrust_is_one_on_the_power(self):
        model, trial = recoil()
        double = Hooks(stroke=(lambda s: Stroke(s.frequency_hz, s.amplitude_rad, 8 * s.thrust),))
        nominal = model.simulate(starts(model), trial)[SPEED]
        # without the inertia of the fin there is no answer
        assert np.isnan(model.simulate_hooked(starts(model), trial, double)[SPEED]).all()
        double = Hooks(stroke=(lambda s: replace(s, thrust=8 * s.thrust),))
        np.testing.assert_allclose(
            model.simulate_hooked(starts(model), trial, double)[SPEED], 2 * nominal, rtol=1e-12
        )

    @pytest.mark.parametrize("linear, dry", [(0.3, 0.0), (0.0, 0.004), (0.2, 0.003), (1e-9, 0.0)])
    def test_other_drag(self, linear, dry):
        """Compare with the power balance for the terminal speed, and with an integrated run from rest."""
        model, trial = recoil()

        def change(c):
            c["linear"] += linear
            c["dry"] += dry

        found = model.simulate_hooked(starts(model), trial, Hooks(coefficients=(change,)))[SPEED]
        nominal = model.simulate(starts(model), trial)[SPEED]
        ratio = velocity_ratio(DRAG_AREA / MASS, trial.inputs["distance_m"])
        for speed, plain, distance in zip(found, nominal / ratio, trial.inputs["distance_m"], strict=True):
            power = DRAG_AREA * plain**3

            def drag(v):
                return dry + linear * v + DRAG_AREA * v * v

            v1 = brentq(lambda v, power=power: v * drag(v) - power, 1e-9, 1.0, xtol=1e-15)
            run = solve_ivp(
                lambda _, s, v1=v1: [s[1], (drag(v1) - drag(s[1])) / MASS],
                (0, 200),
                [0, 0],
                rtol=1e-10,
                atol=1e-13,
                events=lambda _, s, distance=distance: s[0] - distance,
            )
            assert speed == pytest.approx(distance / run.t_events[0][0], rel=1e-7)

    def test_current_carries_both_models(self):
        def current(time_s):
            return np.outer(time_s, [0.02, 0.5]), np.tile([0.02, 0.5], (len(time_s), 1))

        hooks = Hooks(flow=(current,))
        model, trial = recoil()
        nominal = model.simulate(starts(model), trial)[SPEED]
        np.testing.assert_allclose(
            model.simulate_hooked(starts(model), trial, hooks)[SPEED], nominal + 0.02, rtol=1e-12
        )
        model, trial = surge()
        values = starts(model)
        values[-1] = 0.1
        slower = values - [0, 0, 0, 0, 0.02]
        found = model.simulate_hooked(values, trial, hooks)["u_m_s"]
        np.testing.assert_allclose(found, model.simulate(slower, trial)["u_m_s"] + 0.02, atol=1e-9)

    def test_surge_with_linear_drag_alone(self):
        model, trial = surge()
        values = starts(model)
        values[model.index("initial_speed")] = 0.3

        def change(c):
            c["quadratic"] = 0.0
            c["linear"] = 0.4
            c["mass"] *= 2.0

        found = model.simulate_hooked(values, trial, Hooks(coefficients=(change,)))["u_m_s"]
        push = (
            values[0] * (0.3 / model.reference_amplitude_rad) ** 2 * (1.5 / model.reference_frequency_hz) ** 2
        )
        t = trial.time_s - 0.3
        expected = push / 0.4 + (0.3 - push / 0.4) * np.exp(-0.2 * t)
        np.testing.assert_allclose(found, expected, atol=1e-9)

    def test_surge_through_waves(self):
        """Compare with quadrature of the equation, which is linear without quadratic drag."""
        model, trial = surge()

        def change(c):
            c["quadratic"], c["linear"] = 0.0, 0.7

        def waves(time_s):
            speed = np.column_stack([0.05 * np.sin(2 * time_s), 0 * time_s])
            return np.cumsum(speed, axis=0), speed

        values = starts(model)
        values[0] = 0.0
        found = model.simulate_hooked(values, trial, Hooks(coefficients=(change,), flow=(waves,)))["u_m_s"]
        for t, u in zip(trial.time_s, found, strict=True):
            expected = quad(lambda s, t=t: 0.035 * math.sin(2 * s) * math.exp(-0.7 * (t - s)), 0.3, t)[0]
            assert u == pytest.approx(expected, abs=1e-8)
