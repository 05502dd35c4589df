"""Speeds, accelerations and stroke of made tracks, against what they were made of."""

import numpy as np
import pytest

from swimid.kinematics.swimming import SwimTrack, measure_swimming
from swimid.tracking.pose import smooth_path

RATE, BEAT, SWAY, TURN = 30.0, 1.3, 0.02, 0.15


def made(path, heading=None, *, noise=5e-4, seconds=16.0, seed=0, hidden=(0.0, 0.0)):
    """A track as the tracker gives it, of functions of time."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    measured = ~((time >= hidden[0]) & (time < hidden[1]))
    raw = np.where(measured, np.array(path(time)) + rng.normal(0, noise, (2, len(time))), np.nan)
    weights, whole = np.ones(len(time)), [(0, len(time))]
    smoothed = smooth_path(time, raw, weights, whole)
    angle = turn = None
    if heading is not None:
        angle = np.where(measured, heading(time) + rng.normal(0, 0.005, len(time)), np.nan)
        turn = smooth_path(time, angle[None], weights, whole).position[0]
    return SwimTrack(time, measured, raw, smoothed.position, smoothed.velocity, angle, turn)


def swimmer(cruise=0.3, start=1.5, bend=0.1, drift=0.0, phase=0.4):
    """From rest to a cruise on an arc, with a swing across the path and of the heading."""

    def path(t):
        fine = np.linspace(0, t[-1], 20 * len(t))
        speed = cruise * (1 - np.exp(-fine / start)) * (1 + drift * fine / fine[-1])
        course = bend * fine
        step = fine[1]
        x = np.cumsum(speed * np.cos(course)) * step
        y = np.cumsum(speed * np.sin(course)) * step
        swing = SWAY * np.sin(2 * np.pi * BEAT * fine + phase)
        return [
            np.interp(t, fine, x - swing * np.sin(course)),
            np.interp(t, fine, y + swing * np.cos(course)),
        ]

    return path, lambda t: bend * t + TURN * np.sin(2 * np.pi * BEAT * t)


def holds(estimate, truth, slack=0.0):
    return estimate.low - slack <= truth <= estimate.high + slack


@pytest.mark.parametrize("unit", [1.0, 400.0], ids=["m", "px"])
def test_a_start_is_left_out_and_the_cruise_measured(unit):
    """Steady speed, stroke and amplitudes, whatever the unit of length; the start is no part of it."""
    path, heading = swimmer()
    track = made(lambda t: [unit * v for v in path(t)], heading, noise=5e-4 * unit)
    found = measure_swimming(track)
    assert found.window == "steady part"
    assert 2.0 < found.begin_s < 8.0
    assert found.end_s > 15.0
    assert found.steady
    assert found.advance.value / unit == pytest.approx(0.3, rel=0.01)
    assert holds(found.frequency_hz, BEAT, 0.002)
    assert found.amplitudes["sway"].value / unit == pytest.approx(SWAY, rel=0.02)
    assert found.amplitudes["turn"].value == pytest.approx(TURN, rel=0.02)
    along = np.hypot(0.3, SWAY * 2 * np.pi * BEAT * np.cos(np.linspace(0, 2 * np.pi, 200))).mean()
    assert found.path_speed.value / unit == pytest.approx(along, rel=0.01)


@pytest.mark.slow
def test_intervals_contain_the_true_values():
    """Of twenty tracks of a steady swimmer nearly all intervals hold what they are of."""
    hits = dict.fromkeys(("advance", "frequency", "sway", "turn", "acceleration"), 0)
    for seed in range(20):
        path, heading = swimmer(start=1e-6, phase=0.1 * seed)
        found = measure_swimming(made(path, heading, seconds=12.0, seed=seed, noise=2e-3), (0.0, 12.0))
        hits["advance"] += holds(found.advance, 0.3, 1e-5)
        hits["frequency"] += holds(found.frequency_hz, BEAT)
        hits["sway"] += holds(found.amplitudes["sway"], SWAY)
        hits["turn"] += holds(found.amplitudes["turn"], TURN)
        hits["acceleration"] += holds(found.acceleration, 0.0)
    assert min(hits.values()) >= 17, hits  # of 20 at 95 %, fewer come by chance in 2 % of such sets


def test_a_given_window_with_a_changing_speed_is_not_steady():
    """Over the start alone the speed is no steady one."""
    path, heading = swimmer()
    found = measure_swimming(made(path, heading), (0.5, 5.0))
    assert (found.window, found.begin_s, found.end_s) == ("given", 0.5, 5.0)
    assert not found.steady
    assert found.change.low > 0.03


def test_the_amplitude_is_the_mean_over_the_strokes():
    """The sway grows from a half to three halves of its mean, across a straight path."""

    def path(t):
        return [0.3 * t, SWAY * (0.5 + t / 16.0) * np.sin(2 * np.pi * BEAT * t)]

    found = measure_swimming(made(path), (0.0, 16.0))
    assert found.amplitudes["sway"].value == pytest.approx(SWAY, rel=0.08)
    assert found.frequency_hz.value == pytest.approx(BEAT, rel=0.005)


def test_three_whole_strokes_are_enough_for_a_speed():
    """The mean over a stroke takes half a stroke from either end of a track of 4.4 strokes."""
    path, heading = swimmer(start=1e-6, bend=0.0)
    found = measure_swimming(made(path, heading, noise=1e-5, seconds=4.4 / BEAT))
    assert found.frequency_hz.value == pytest.approx(BEAT, rel=0.01)
    assert found.advance.value == pytest.approx(0.3, rel=0.01)
    assert abs(found.acceleration.value) < 0.01


@pytest.mark.parametrize("acceleration", [(30.0, -340.0), (0.0, 5.0)])
def test_constant_acceleration_is_measured(acceleration):
    """A block on a ramp, px: nothing is steady, and both accelerations are told."""
    ax, ay = acceleration
    track = made(lambda t: [20 * t + ax * t**2 / 2, 3 * t + ay * t**2 / 2], noise=0.1, seconds=3.0)
    found = measure_swimming(track)
    assert found.window == "whole track"
    assert not found.steady
    assert found.stroke.beat is None
    for estimate, truth in zip(found.acceleration_xy, acceleration, strict=True):
        assert estimate.value == pytest.approx(truth, abs=0.4)
        assert holds(estimate, truth)


def test_rest_is_no_steady_swimming():
    """Three fifths of the film the robot rests: the steady part is where it swims."""

    def path(t):
        return [0.25 * np.maximum(t - 10.0, 0.0), 0.0 * t]

    found = measure_swimming(made(path))
    assert found.begin_s > 9.0
    assert found.advance.value == pytest.approx(0.25, rel=0.02)


def test_gaps_are_left_out_and_a_drifting_speed_is_not_steady():
    """A dropout is bridged; a speed that grows all the time has no steady part."""
    path, heading = swimmer(start=0.2)
    found = measure_swimming(made(path, heading, hidden=(7.0, 7.6)))
    assert found.window == "steady part"
    assert found.advance.value == pytest.approx(0.3, rel=0.01)
    path, heading = swimmer(start=1e-6, drift=1.0)
    assert measure_swimming(made(path, heading)).window == "whole track"


def test_a_single_marker_shows_the_stroke_by_its_course():
    path, _ = swimmer(start=1e-6, bend=0.5)
    found = measure_swimming(made(path))
    assert found.frequency_hz.value == pytest.approx(BEAT, rel=0.01)
    assert found.amplitudes["sway"].value == pytest.approx(SWAY, rel=0.03)


@pytest.mark.parametrize("with_heading", [True, False])
def test_a_robot_that_heaves_in_place_has_a_stroke(with_heading):
    """No way is made: the stroke is told all the same, and no speed is called steady."""
    heading = (lambda t: 0.3 + 0.0 * t) if with_heading else None
    swing = np.array([-np.sin(0.3), np.cos(0.3)])
    found = measure_swimming(
        made(lambda t: np.outer(swing, 0.05 * np.sin(2 * np.pi * 1.1 * t)), heading, seconds=8.0)
    )
    assert found.frequency_hz.value == pytest.approx(1.1, rel=0.01)
    assert found.amplitudes["sway"].value == pytest.approx(0.05, rel=0.02)


def test_laps_are_no_strokes():
    """A point on a circle comes back again and again, at one speed."""
    found = measure_swimming(made(lambda t: [np.cos(1.2 * t), np.sin(1.2 * t)], seconds=16.0))
    assert found.stroke.beat is None
    assert found.advance.value == pytest.approx(1.2, rel=0.003)


def test_a_long_gap_belongs_to_no_block():
    path, heading = swimmer(start=1e-6)
    track = made(path, heading, seconds=20.0)
    hole = (track.time_s > 8.0) & (track.time_s < 12.0)
    for values in (track.raw, track.smooth, track.velocity):
        values[:, hole] = np.nan
    for values in (track.measured, track.raw_angle, track.angle):
        values[hole] = False if values.dtype == bool else np.nan
    found = measure_swimming(track)
    assert found.advance.value == pytest.approx(0.3, rel=0.005)
    assert found.frequency_hz.value == pytest.approx(BEAT, rel=0.01)
