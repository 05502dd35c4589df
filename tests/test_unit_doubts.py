"""Columns of a log with unusual values, and the unit that would explain them."""

from __future__ import annotations

import numpy as np
import pytest

from swimid.logs.log import doubts

TIME = np.arange(0.0, 10.0, 0.02)
WAVE = np.sin(2.0 * np.pi * TIME)


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        # many turns of a heading are no doubt, and angles of joints or of a tilt that go round are
        ("yaw_rad", 2.0 * TIME, ""),
        ("yaw_rad", 6.5 * WAVE, ""),
        ("joint1_rad", 6.5 * WAVE, "57.3"),
        ("joint1_rad", 6.0 * WAVE, ""),
        ("cmd2_rad", 6.5 * WAVE, "57.3"),
        ("roll_rad", 5.0 * WAVE, "57.3"),
        ("pitch_rad", -4.8 * np.abs(WAVE), "57.3"),
        ("pitch_rad", 4.6 * WAVE, ""),
        ("heel_rad", 5.0 * WAVE, ""),
        # an angle that jumps from 180 to -180 is in degrees; from pi to -pi it is in radians
        ("yaw_rad", (30.0 * TIME + 180.0) % 360.0 - 180.0, "57.3"),
        ("yaw_rad", (-30.0 * TIME + 180.0) % 360.0 - 180.0, "57.3"),
        ("yaw_rad", (0.5 * TIME + np.pi) % (2 * np.pi) - np.pi, ""),
        ("yaw_rad", (0.3 * WAVE + 2.0 * np.pi) % (2 * np.pi) - np.pi, ""),
        ("yaw_rad", (0.3 * WAVE) % (2 * np.pi), ""),
        ("yaw_rad", 20.0 * WAVE, "turns at"),
        ("yaw_rate_rad_s", 59.0 * WAVE, ""),
        ("yaw_rate_rad_s", 61.0 * WAVE, "degrees per second"),
        ("x_m", 3.0 * TIME, ""),
        ("x_m", 300.0 * TIME, "moves at 300 m/s"),
        ("y_m", 200.0 + 45.0 * np.sin(0.3 * TIME), ""),
        ("z_m", np.linspace(-49.0, 49.0, len(TIME)), ""),
        ("z_m", np.linspace(-51.0, 51.0, len(TIME)), "extends over 102 m"),
        ("u_m_s", 0.5 + WAVE, ""),
        ("u_m_s", -300.0 + 200.0 * WAVE, "millimetres per second"),
        ("force_N", 1e6 * WAVE, ""),
    ],
)
def test_values_that_no_swimmer_has(name: str, values: np.ndarray, words: str) -> None:
    found = doubts(TIME, {"t_s": TIME, name: values})
    assert [one.column for one in found] == [name] * bool(words)
    assert all(words in one.text for one in found)


@pytest.mark.parametrize(
    ("step", "count", "doubted"), [(20.0, 200, True), (4.0, 1000, False), (20.0, 90, False)]
)
def test_times_in_milliseconds(step: float, count: int, doubted: bool) -> None:
    time = step * np.arange(count)
    assert [one.column for one in doubts(time, {"t_s": time})] == ["t_s"] * doubted
