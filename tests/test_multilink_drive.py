"""Motion of the driven joints: waveforms, measured angles, servos."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_smoothing_spline

from swimid.fitting import drives
from swimid.fitting.model import SwimInput, Trial
from swimid.robots.file import Robot, schema_of
from swimid.swimmer import drive
from swimid.swimmer.planar.model import MultilinkModel

WAVEFORMS = [("sine", 0.0), ("hopf", 0.0), ("a-cpg", 0.0), ("a-cpg", 0.4), ("a-cpg", -0.6)]


@pytest.mark.parametrize(("waveform", "asymmetry"), WAVEFORMS)
class TestBeat:
    def beat(self, waveform: str, asymmetry: float, **others: float) -> drives.TailBeat:
        given = {"bias_rad": 0.2, "ramp_s": 1.5, **others}
        return drives.TailBeat(waveform, 1.3, 0.5, asymmetry=asymmetry, **given)

    def test_derivatives(self, waveform: str, asymmetry: float) -> None:
        """Rate and acceleration are derivatives of the angle, except where an asymmetric beat turns."""
        beat, step = self.beat(waveform, asymmetry), 1e-4
        times = np.arange(0.0, 5.0, 0.0137) + 1e-3
        early, (_, rate, bend), late = (
            beat.motion(times + by, gain=0.7, phase_rad=0.3) for by in (-step, 0.0, step)
        )
        # a central difference errs by h^2 / 6 of the third derivative; over a turn by h / 4 of the jump
        third = 0.5 * (2 * math.pi * 1.3 / (1 - abs(asymmetry))) ** 3 + 60 * 0.5 / 1.5**3
        smooth = np.abs(late[2] - early[2]) < 4 * step * third
        assert smooth.mean() > 0.99
        np.testing.assert_allclose(
            ((late[0] - early[0]) / (2 * step))[smooth], rate[smooth], atol=step**2 * third
        )
        slopes = (late[1] - early[1]) / (2 * step)
        fourth = third * 2 * math.pi * 1.3 / (1 - abs(asymmetry))
        np.testing.assert_allclose(slopes[smooth], bend[smooth], atol=step**2 * fourth)

    def test_period(self, waveform: str, asymmetry: float) -> None:
        beat = self.beat(waveform, asymmetry, ramp_s=0.0)
        times = np.linspace(0.0, 3.0, 977)
        for now, later in zip(beat.motion(times), beat.motion(times + 1 / 1.3), strict=True):
            # a turn that falls between the two within rounding moves only the acceleration
            close = np.isclose(now, later, rtol=1e-9, atol=1e-9)
            assert close.mean() > 0.995

    def test_durations_of_the_half_beats(self, waveform: str, asymmetry: float) -> None:
        """The angle rises in (1 - h) half periods and falls in (1 + h)."""
        beat = self.beat(waveform, asymmetry, ramp_s=0.0, bias_rad=0.0)
        times = np.linspace(0.0, 10 / 1.3, 200_001)
        angle, rate, _ = beat.motion(times)
        assert np.mean(rate > 0) == pytest.approx(0.5 * (1 - asymmetry), abs=1e-4)
        assert angle.max() == pytest.approx(0.5, abs=1e-6)
        assert angle.min() == pytest.approx(-0.5, abs=1e-6)
        assert angle[0] == pytest.approx(0.0, abs=1e-12)
        assert rate[0] > 0

    def test_phase_lag_is_a_delay(self, waveform: str, asymmetry: float) -> None:
        beat = self.beat(waveform, asymmetry, ramp_s=0.0)
        times, lag = np.linspace(2.0, 4.0, 500), 0.9
        lagging = beat.motion(times, phase_rad=-lag)
        late = beat.motion(times - lag / (2 * math.pi * 1.3))
        np.testing.assert_allclose(lagging[:2], late[:2], atol=1e-10)

    def test_straight_and_still_at_the_start(self, waveform: str, asymmetry: float) -> None:
        beat = self.beat(waveform, asymmetry)
        for part in beat.motion(np.array([-1.0, -0.01, 0.0])):
            np.testing.assert_array_equal(part, 0.0)

    def test_bias_and_gains(self, waveform: str, asymmetry: float) -> None:
        times = np.linspace(3.0, 5.0, 300)
        plain, biased = self.beat(waveform, asymmetry, bias_rad=0.0), self.beat(waveform, asymmetry)
        found = biased.motion(times, gain=0.5, bias_gain=2.0)
        np.testing.assert_allclose(found[0], 0.5 * plain.motion(times)[0] + 2.0 * 0.2, atol=1e-12)
        np.testing.assert_allclose(found[1], 0.5 * plain.motion(times)[1], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("asymmetry", [0.0, 0.3, 0.7, -0.5])
def test_hopf_solves_eq_10(asymmetry: float) -> None:
    """Eq 10 with radius one settles on :func:`drives.hopf` from any initial radius."""
    omega = 2 * math.pi * 1.1

    def right(_: float, point: np.ndarray) -> list[float]:
        alpha, beta = point
        turn = omega / (1 - asymmetry * np.sign(-beta))
        pull = 1 - alpha**2 - beta**2
        return [-turn * beta + alpha * pull, turn * alpha + beta * pull]

    times = np.linspace(0.0, 12.0, 2401)
    for radius in (1.0, 0.3):
        run = solve_ivp(
            right, (0.0, 12.0), (0.0, -radius), "DOP853", times, rtol=1e-9, atol=1e-11, max_step=4e-3
        )
        alpha, rate, _ = drives.hopf(times, 1.1, asymmetry)
        settled = times > (0.0 if radius == 1.0 else 10.0)
        # where the spin changes the step that straddles it errs by up to its own length
        np.testing.assert_allclose(run.y[0][settled], alpha[settled], atol=2e-5)
        slope = np.array([right(0.0, point)[0] for point in run.y.T])
        np.testing.assert_allclose(slope[settled], rate[settled], atol=1e-3)


def test_one_time_is_eased_like_many() -> None:
    assert drives.ease_in(0.5, 1.0) == drives.ease_in(np.array([0.5]), 1.0)[0] == 0.5


def test_smoothstep() -> None:
    times = np.linspace(-0.5, 2.5, 3001)
    ease, slope, curve = drives.smoothstep(times, 2.0)
    assert ease[times <= 0].max() == 0.0
    assert ease[times >= 2.0].min() == 1.0
    assert (np.diff(ease) >= 0).all()
    np.testing.assert_allclose(ease + drives.smoothstep(2.0 - times, 2.0)[0], 1.0, atol=1e-14)
    np.testing.assert_allclose(np.gradient(ease, times)[1:-1], slope[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(slope, times)[1:-1], curve[1:-1], atol=1e-2)
    assert np.abs(np.diff(curve)).max() < 0.02
    step = drives.smoothstep(np.array([-1e-9, 0.0, 1.0]), 0.0)
    np.testing.assert_array_equal(step, [[0, 1, 1], [0, 0, 0], [0, 0, 0]])


@pytest.mark.kernels
class TestMeasured:
    def noisy(self, rng: np.random.Generator, noise: float) -> tuple[np.ndarray, ...]:
        times = np.arange(0.0, 12.0, 0.02)
        omega = 2 * math.pi * 1.4
        angle = 0.35 * np.sin(omega * times)
        truth = (angle, 0.35 * omega * np.cos(omega * times), -(omega**2) * angle)
        return times, angle + noise * rng.standard_normal(len(times)), *truth

    def test_rates_from_noisy_samples(self, rng: np.random.Generator) -> None:
        """One spline gives rates and accelerations several times closer than differences do.

        At 50 Hz; nor does it matter whether the beat is slow or the record long.
        """
        times, seen, angle, rate, bend = self.noisy(rng, math.radians(0.5))
        motion = drive.spline_motion(drive.fit_spline(times, seen))
        found = motion(times)
        middle = slice(25, -25)

        def error(estimate: np.ndarray, truth: np.ndarray) -> float:
            return float(np.sqrt(np.mean((estimate - truth)[middle] ** 2)))

        once = np.gradient(seen, times)
        assert error(found[0], angle) < 0.7 * math.radians(0.5)
        assert error(found[1], rate) < error(once, rate) / 2.5
        assert error(found[2], bend) < error(np.gradient(once, times), bend) / 3

    @pytest.mark.parametrize("rate_hz", [20.0, 100.0, 1000.0])
    @pytest.mark.parametrize("beat_hz", [0.3, 2.0])
    def test_any_sampling_rate(self, rate_hz: float, beat_hz: float, rng: np.random.Generator) -> None:
        """The smoothed angle is closer to the truth than the samples at any sampling rate."""
        times = 1e3 + np.arange(0.0, 10.0, 1 / rate_hz)
        angle, noise = 0.3 * np.sin(2 * math.pi * beat_hz * times), 0.005
        seen = angle + noise * rng.standard_normal(len(times))
        found = drive.spline_motion(drive.fit_spline(times, seen))(times)[0]
        assert np.sqrt(np.mean((found - angle) ** 2)) < noise

    def test_smoothing_minimises_thecross_validation_score_score(self, rng: np.random.Generator) -> None:
        """The banded score equals that of the full influence matrix."""
        places = np.cumsum(rng.uniform(0.5, 1.5, 30))
        seen = np.sin(places / 3) + 0.1 * rng.standard_normal(30)
        for smoothing in (1e-3, 1.0, 50.0):
            columns = [make_smoothing_spline(places, unit, lam=smoothing)(places) for unit in np.eye(30)]
            left = np.eye(30) - np.column_stack(columns)
            score = 30 * np.sum((left @ seen) ** 2) / np.trace(left) ** 2
            assert drive.cross_validation_score(smoothing, np.diff(places), seen) == pytest.approx(
                score, rel=1e-9
            )

    def test_clean_samples_are_kept(self, rng: np.random.Generator) -> None:
        times, seen, angle, rate, _ = self.noisy(rng, 0.0)
        found = drive.spline_motion(drive.fit_spline(times, seen))(times)
        np.testing.assert_allclose(found[0], angle, atol=1e-4)
        # differences of clean samples are wrong by (omega h)^2 / 6 of the rate
        assert (
            np.abs(found[1] - rate)[25:-25].max()
            < 0.2 * np.abs(np.gradient(seen, times) - rate)[25:-25].max()
        )

    def test_angle_rate_and_acceleration_agree(self, rng: np.random.Generator) -> None:
        times, seen, *_ = self.noisy(rng, 0.01)
        motion = drive.spline_motion(drive.fit_spline(times, seen))
        fine = np.linspace(1.0, 10.0, 90_001)
        angle, rate, bend = motion(fine)
        np.testing.assert_allclose(np.gradient(angle, fine)[1:-1], rate[1:-1], atol=1e-5)
        np.testing.assert_allclose(np.gradient(rate, fine)[1:-1], bend[1:-1], atol=0.2)

    def test_gaps_and_jumps_of_a_turn(self, rng: np.random.Generator) -> None:
        times, seen, angle, *_ = self.noisy(rng, 0.001)
        seen[100:104] = np.nan
        wrapped = np.angle(np.exp(1j * (seen + math.pi)))
        found = drive.spline_motion(drive.fit_spline(times, wrapped))(times)[0]
        offset = 2 * math.pi * np.round((found[0] - angle[0] - math.pi) / (2 * math.pi))
        np.testing.assert_allclose(found - math.pi - offset, angle, atol=0.02)

    def test_the_angle_is_held_beyond_its_ends(self, rng: np.random.Generator) -> None:
        times, seen, *_ = self.noisy(rng, 0.001)
        motion = drive.spline_motion(drive.fit_spline(times, seen))
        outside, ends = motion(np.array([-1.0, 100.0])), motion(times[[0, -1]])
        np.testing.assert_allclose(outside[0], ends[0], atol=1e-14)
        np.testing.assert_array_equal(outside[1:], 0.0)

    def test_too_few_samples(self) -> None:
        with pytest.raises(ValueError, match="at least 5"):
            drive.fit_spline(np.arange(6.0), np.array([0.0, 1.0, np.nan, 2.0, np.nan, 1.0]))


@pytest.mark.kernels
class TestServo:
    OMEGA, DAMPING = 2 * math.pi * 4.0, 0.6

    def ramp_answer(self, times: np.ndarray) -> np.ndarray:
        """Return the angle of a second-order servo at rest whose command starts to rise by 1 rad/s."""
        omega, z = self.OMEGA, self.DAMPING
        damped = omega * math.sqrt(1 - z * z)
        fading = np.exp(-z * omega * times)
        return (
            times
            - 2 * z / omega
            + fading
            * (2 * z / omega * np.cos(damped * times) + (2 * z * z - 1) / damped * np.sin(damped * times))
        )

    def test_ramp(self) -> None:
        errors = []
        for step in (0.01, 0.005, 0.0025):
            times = step * np.arange(round(1.0 / step) + 1)
            found = drive.simulate_servo(
                0.5 * step * np.arange(2 * len(times) - 1), step, self.OMEGA, self.DAMPING
            )
            errors.append(np.abs(found[:, 0] - self.ramp_answer(times)).max())
            # central differences err by h^2 / 6 of what is largest at the start: omega^2, 2 z omega^3
            jerks = (self.OMEGA**2, 2 * self.DAMPING * self.OMEGA**3)
            for k, jerk in enumerate(jerks):
                slope = np.gradient(found[:, k], step)[2:-2]
                np.testing.assert_allclose(slope, found[2:-2, k + 1], atol=1.05 * step**2 / 6 * jerk)
        np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 4.0, atol=0.3)
        assert errors[1] < 2e-7

    def test_a_servo_starts_at_its_command(self) -> None:
        found = drive.simulate_servo(np.full(201, 0.3), 0.01, self.OMEGA, self.DAMPING)
        np.testing.assert_allclose(found, np.tile([0.3, 0.0, 0.0], (101, 1)), atol=1e-15)

    def test_sine_in_a_robot(self) -> None:
        """Gain and lag of the settled joint are those of the transfer function."""
        model = MultilinkModel(_two_links({"servo": {"natural_frequency_hz": 4.0, "damping_ratio": 0.6}}))
        times = np.linspace(0.0, 10.0, 1001)
        values = np.array([p.start for p in model.parameters])
        beat = drives.TailBeat("sine", 1.5, 0.4)
        found = model.simulate(values, Trial("run", "fit", times, {}, swim=SwimInput(beat)))["joint1_rad"]
        s = 2j * math.pi * 1.5
        answer = self.OMEGA**2 / (s * s + 2 * self.DAMPING * self.OMEGA * s + self.OMEGA**2)
        expected = 0.4 * np.imag(answer * np.exp(s * times))
        np.testing.assert_allclose(found[times > 5], expected[times > 5], atol=2e-6)


def _two_links(driven: dict[str, Any]) -> Robot:
    link = {"length_m": 0.2, "mass_kg": 1.0, "com_m": 0.1, "inertia_kg_m2": 0.004, "inertia_about": "com"}
    body = {
        "plane": "horizontal",
        "links": [{**link, "name": "front"}, {**link, "name": "rear"}],
        "joints": [
            {"name": "hinge", "parent": "front", "child": "rear", "mount_deg": 10.0, "driven": driven}
        ],
    }
    return schema_of().model_validate({"format": "swimid-robot/1", "name": "pair", "multilink": body})


@pytest.mark.kernels
class TestInARobot:
    TIMES = np.linspace(0.0, 4.0, 401)

    def run(self, model: MultilinkModel, swim: SwimInput, **given: float) -> dict[str, np.ndarray]:
        values = np.array([given.get(p.name, p.start) for p in model.parameters])
        return model.simulate(values, Trial("run", "fit", self.TIMES, {}, swim=swim))

    def test_share_lag_and_phase(self) -> None:
        model = MultilinkModel(_two_links({"gain": -0.5, "bias_gain": 0.25, "phase_lag_deg": 30.0}))
        beat = drives.TailBeat("a-cpg", 0.8, 0.6, bias_rad=0.2, asymmetry=0.3, ramp_s=1.0)
        found = self.run(model, SwimInput(beat), drive_phase=0.4)["joint1_rad"]
        expected = beat.motion(self.TIMES, gain=-0.5, bias_gain=0.25, phase_rad=0.4 - math.radians(30.0))[0]
        np.testing.assert_allclose(found, expected, atol=1e-12)

    def test_turning_points_of_an_asymmetric_beat_may_lie_between_steps(self) -> None:
        """The error has second order in the step. Sampled accelerations with jumps would give first."""
        beat = drives.TailBeat("a-cpg", 0.83, 0.5, asymmetry=0.4)
        robot = _two_links({})
        fine = self.run(MultilinkModel(robot, max_step=1e-4), SwimInput(beat))
        errors = []
        for step in (5e-3, 2.5e-3):
            found = self.run(MultilinkModel(robot, max_step=step), SwimInput(beat))
            errors.append([np.abs(found[n] - fine[n]).max() for n in ("x_m", "y_m", "yaw_rad")])
        assert np.all(np.array(errors[1]) < 0.4 * np.array(errors[0]))

    def test_a_measured_angle_gives_the_motion_of_the_beat(self) -> None:
        """A clean record of a joint, sampled every 10 ms, gives the motion that the command gave."""
        model = MultilinkModel(_two_links({}))
        beat = drives.TailBeat("sine", 1.0, 0.5)
        told = self.run(model, SwimInput(beat))
        motion = drive.spline_motion(drive.fit_spline(self.TIMES, told["joint1_rad"]))
        seen = self.run(MultilinkModel(_two_links({})), SwimInput(joints=[motion]))
        assert np.abs(told["yaw_rad"]).max() > 0.1
        for name in ("x_m", "y_m", "yaw_rad"):
            np.testing.assert_allclose(seen[name], told[name], atol=1e-4)

    def test_a_joint_without_a_drive_stays_straight(self) -> None:
        found = self.run(MultilinkModel(_two_links({})), SwimInput())
        assert all((np.abs(v) < 1e-15).all() for v in found.values())

    def test_table(self) -> None:
        motions = [(np.array([0.1, 0.2]), np.array([1.0, 2.0]), np.array([3.0, 4.0]))]
        (first, second) = drive.drive_table(2, motions, [0.5])[:, 0]
        np.testing.assert_allclose(first, [0.1, 1.0, 3.0, math.cos(0.6), math.sin(0.6)])
        np.testing.assert_allclose(second, [0.2, 2.0, 4.0, math.cos(0.7), math.sin(0.7)])
