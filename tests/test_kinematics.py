"""Kinematics of known motions: whole cycles, mean speed and velocities against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from swimid.kinematics.cycles import (
    PER_CYCLE,
    QUANTITIES,
    Window,
    body_velocity,
    cycle_means,
    cycle_speeds,
    last_cycles,
)

#: Times of ten cycles of 1 Hz, s.
TIME = np.linspace(0.0, 10.0, 10 * PER_CYCLE + 1)


def test_the_speed_on_a_circle_is_that_of_the_arc() -> None:
    """Mean positions of a body that turns by 0.6 rad per cycle on a circle of 1 m."""
    place = np.array([np.cos(0.6 * TIME), np.sin(0.6 * TIME)])
    window = last_cycles(0.0, 10.0, 1.0)
    assert window is not None
    for heading in (None, 0.6 * TIME + 0.3 * np.sin(2 * np.pi * TIME)):
        speeds = cycle_speeds(TIME, place, window, heading)
        assert speeds == pytest.approx(np.full(3, 0.6), rel=1e-3)


@pytest.mark.parametrize("phase_rad", [0.0, 1.0, 2.5])
def test_the_mean_speed_does_not_depend_on_the_phase_of_the_swing(phase_rad: float) -> None:
    swing = 1.0 + 0.1 * np.sin(2 * np.pi * TIME + phase_rad)
    place = swing * np.array([np.cos(0.5 * TIME), np.sin(0.5 * TIME)])
    window = last_cycles(0.0, 10.0, 1.0)
    assert window is not None
    speeds = cycle_speeds(TIME, place, window, 0.5 * TIME)
    assert float(speeds.mean()) == pytest.approx(0.5, rel=2e-3)


def test_one_cycle_has_the_speed_between_its_ends() -> None:
    window = Window(2.0, 3.0, 1, 1.0)
    place = np.array([0.2 * TIME, 0.05 * np.sin(2 * np.pi * TIME)])
    assert cycle_speeds(TIME, place, window) == pytest.approx([0.2])


def test_means_of_cycles_are_exact_for_straight_lines() -> None:
    means = cycle_means(TIME, np.array([TIME, 3.0 * TIME]), np.array([1.0, 2.0, 4.0]))
    assert means == pytest.approx(np.array([[1.5, 3.0], [4.5, 9.0]]))


def test_the_velocity_of_a_body_follows_from_its_pose() -> None:
    heading = 0.4 * TIME
    place = [np.sin(heading) / 0.4 * 0.3, (1.0 - np.cos(heading)) / 0.4 * 0.3]
    surge, sway, rate = body_velocity(TIME, [*place, heading], 0.1)
    known = np.isfinite(surge)
    assert surge[known] == pytest.approx(0.3, rel=1e-6)
    assert sway[known] == pytest.approx(0.0, abs=1e-6)
    assert rate[known] == pytest.approx(0.4)


def test_every_quantity_has_a_unit_that_its_name_ends_in() -> None:
    for name, kind in QUANTITIES.items():
        ending = {"1": "strouhal", "rad/s": "rad_s", "m/s": "m_s", "N m": "N_m"}.get(kind.unit, kind.unit)
        assert name.endswith(ending.replace("/", "_")), name
        assert set(kind.of.split()) <= {"plane", "cycle", "power"}
