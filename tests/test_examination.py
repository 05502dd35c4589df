"""Examination of a log by ``swimid import``: jumps and spikes of channels, courses, clocks, rests."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from swimid import guess_mapping, import_log
from swimid.kinematics.frequency import find_beat

N = 1500
T = np.arange(N) / 50.0
YAW = 0.3 * np.sin(2 * np.pi * 1.3 * T) + 0.05 * T + 2.5


def _noise(size: float, seed: int = 0) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=N)


def _bursts(seed: int = 1, most: int = 15) -> np.ndarray:
    """Flag ten bursts of 2 to ``most`` samples."""
    rng, flags = np.random.default_rng(seed), np.zeros(N, dtype=bool)
    for first in 20 + 145 * np.arange(10):
        flags[first : first + rng.integers(2, most)] = True
    return flags


def _import(columns: dict[str, Any], time: np.ndarray = T, **options: Any) -> Any:
    return import_log(pd.DataFrame({"t_s": time, **columns}), **options)


def _reason(made: Any) -> str:
    return str(made.data["verdict"]["text"])


# ---------------------------------------------------------------- jumps and spikes


@pytest.mark.parametrize(("column", "turn"), [("yaw_rad", 180.0), ("roll_rad", 90.0), ("joint1_rad", 90.0)])
def test_flipped_angles_are_left_out(column: str, turn: float) -> None:
    flipped = _bursts()
    angle = np.angle(np.exp(1j * (YAW + np.radians(turn) * flipped + _noise(0.003))))
    made = _import({column: angle})
    assert np.array_equal(made.frame[column].isna(), np.zeros(len(made.frame), dtype=bool))
    assert len(made.frame) == N - flipped.sum()
    assert made.data["jumps"] == {column: flipped.sum()}
    assert made.data["verdict"]["level"] == "caution"
    assert made.data["stroke"]["frequency_hz"] == pytest.approx(1.3, abs=2e-3)
    kept = _import({column: angle}, clean=False)
    assert len(kept.frame) == N
    assert "kept (lines" in _reason(kept)


@pytest.mark.slow
def test_flipped_quaternions_are_left_out_and_signs_are_harmless() -> None:
    flipped = _bursts(2)
    rng = np.random.default_rng(3)
    turns = Rotation.from_euler("ZYX", np.column_stack((YAW + np.pi / 2 * flipped, 0.02 * np.sin(T), 0 * T)))
    q = turns.as_quat(scalar_first=True) * np.where(rng.random(N) < 0.3, -1.0, 1.0)[:, None]
    track = {"x_m": 0.2 * T + _noise(3e-4, 4), "y_m": 0.02 * np.sin(2 * np.pi * 1.3 * T) + _noise(3e-4, 5)}
    made = _import({**track, **dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True))})
    assert np.array_equal(made.frame["qx"].isna(), flipped)
    assert not made.frame["x_m"].isna().any()
    assert made.data["jumps"] == {"qw, qx, qy, qz": flipped.sum()}


def test_a_heading_that_stays_turned_is_named() -> None:
    made = _import({"yaw_rad": YAW - 2.5 + np.pi * (T > 20) + _noise(0.003)})
    assert "goes on at another value in line" in _reason(made)
    assert made.data["verdict"]["level"] == "caution"


@pytest.mark.parametrize(
    ("code", "where"),
    [(0.0, "start"), (0.0, "end"), (-1.0, "middle"), (-999.0, "scattered"), (0.0, "scattered")],
)
def test_lost_samples_of_a_single_position_are_named(code: float, where: str) -> None:
    lost = np.zeros(N, dtype=bool)
    places = {
        "start": slice(6),
        "middle": slice(700, 703),
        "end": slice(-4, None),
        "scattered": slice(40, None, 290),
    }
    lost[places[where]] = True
    made = _import({"x_m": np.where(lost, code, 0.05 + 0.1 * T + _noise(2e-4))})
    assert made.data["jumps"] == {"x_m": lost.sum()}
    assert f"missing: [{code:g}]" in _reason(made)
    assert len(made.frame) == N - lost.sum()


SPIKES = {
    "powers of two": lambda x, rng: rng.choice(2.0 ** np.arange(20, 24) - 1, size=len(x)) * 5e-5,
    "sign": lambda x, rng: -0.84 * x,
    "zero": lambda x, rng: 0.0 * x,
}


@pytest.mark.parametrize("kind", SPIKES)
@pytest.mark.parametrize("share", [0.005, 0.05])
def test_spikes_of_a_force_are_left_out(kind: str, share: float) -> None:
    rng = np.random.default_rng(7)
    force = 1.0 + 0.3 * np.sin(2 * np.pi * 0.7 * T) + _noise(0.004)
    bad = rng.random(N) < share
    made = _import(
        {"force_N": np.where(bad, SPIKES[kind](force, rng), force), "u_m_s": 0.3 + _noise(0.01, 8)}
    )
    assert made.data["verdict"]["level"] == "caution"
    found = made.frame["force_N"].isna()
    assert np.sum(found & bad) >= 0.95 * bad.sum()
    assert np.sum(found & ~bad) <= 0.001 * N


def _impacts() -> np.ndarray:
    hits, k = np.zeros(N), np.arange(40)
    for first in range(100, N - 50, 190):
        hits[first : first + 40] += 8.0 * np.exp(-k / 6.0) * np.cos(2 * np.pi * k / 9.0)
    return hits


SOUND = {
    "square wave": {"force_N": 2.0 * signal.square(2 * np.pi * 0.5 * T) + _noise(0.01)},
    "impacts": {"force_N": _impacts() + _noise(0.02)},
    "step": {"force_N": 5.0 * (T > 15) + _noise(0.01)},
    "exponential noise": {"force_N": np.random.default_rng(2).laplace(size=N)},
    "short pulses": {"force_N": 3.0 * (T % 5 < 0.1) + _noise(0.01)},
    "servo steps": {"joint1_rad": 0.7 * np.clip(9 * np.sin(2 * np.pi * 0.5 * T), -1, 1) + _noise(0.002)},
    "wrapped heading": {"yaw_rad": np.angle(np.exp(3j * T)) + _noise(0.001)},
    "fast turn": {"yaw_rad": 1.5 / (1 + np.exp(-25 * (T - 15))) + _noise(0.002)},
    "attitude through the vertical": dict(
        zip(
            ("yaw_rad", "pitch_rad", "roll_rad"),
            Rotation.from_rotvec(np.outer(0.7 * T, [0.0, 1.0, 0.05])).as_euler("ZYX").T * [[1], [-1], [1]],
            strict=True,
        )
    ),
    "sensor at a tenth of the rate": {"yaw_rad": np.repeat(YAW[::10], 10) + 0.0},
}


@pytest.mark.parametrize("kind", SOUND)
def test_sound_channels_have_no_jumps(kind: str) -> None:
    assert _import(SOUND[kind]).data["jumps"] == {}


# ---------------------------------------------------------------- frozen channels


def test_commands_and_scores_may_hold_one_value() -> None:
    held = (T > 11) & (T < 16)
    drive = np.where(held, 0.0, 2.0 + np.sin(3 * T) + _noise(0.05))
    track = {"x_m": 0.2 * T + _noise(3e-4, 4), "y_m": _noise(3e-4, 5)}
    names = ("thrust1_N", "pwm_us", "tail_score", "motor_V", "pump_W")
    held_ones = {name: (k + 1) * drive for k, name in enumerate(names)}
    assert "hold one value" not in _reason(_import({**track, **held_ones}))
    frozen = _import({"yaw_rad": np.where(held, YAW[550], YAW + _noise(0.003))})
    assert "hold one value" in _reason(frozen)
    assert frozen.data["verdict"]["level"] == "bad"


def test_a_short_freeze_does_not_condemn_a_log() -> None:
    yaw = YAW + _noise(0.003)
    yaw[700:714] = yaw[700]
    made = _import({"yaw_rad": yaw})
    assert "hold one value" in _reason(made)
    assert made.data["verdict"]["level"] == "caution"


# ---------------------------------------------------------------- course and heading


def _track(turn: float = 0.0) -> dict[str, np.ndarray]:
    beat = 2 * np.pi * 1.3 * T
    course = 0.35 + turn * T
    place = np.cumsum(0.2 * np.exp(1j * course)) / 50 + 0.01j * np.sin(beat) * np.exp(1j * course)
    return {
        "x_m": place.real + _noise(2e-4, 1),
        "y_m": place.imag + _noise(2e-4, 2),
        "yaw_rad": course + 0.2 * np.cos(beat),
    }


@pytest.mark.parametrize(("turn", "off"), [(0.0, 0.0), (0.4, 0.0), (0.0, 180.0), (0.05, -90.0), (0.4, 55.0)])
def test_a_heading_at_an_angle_to_the_course_is_named(turn: float, off: float) -> None:
    columns = _track(turn)
    columns["yaw_rad"] = columns["yaw_rad"] + np.radians(off)
    made = _import(columns)
    if off:
        stated = re.search(r"stands at (\d+) degrees", _reason(made))
        assert stated is not None
        assert float(stated[1]) == pytest.approx(abs(off), abs=3.0)
        assert made.data["verdict"]["level"] == "caution"
    else:
        assert made.data["verdict"]["level"] == "good"


def test_the_pitch_is_compared_with_the_path_in_the_vertical_plane() -> None:
    columns = _track()
    side = {"x_m": columns["x_m"], "z_m": columns["y_m"], "pitch_rad": columns["yaw_rad"]}
    assert _import(side).data["verdict"]["level"] == "good"
    assert "degrees to the course" in _reason(_import({**side, "pitch_rad": side["pitch_rad"] + np.pi}))


def test_a_robot_that_hovers_has_no_course() -> None:
    rng = np.random.default_rng(5)
    place = np.cumsum(rng.normal(size=(2, N)), axis=1) * 2e-3
    made = _import({"x_m": place[0], "y_m": place[1], "yaw_rad": 0.1 * np.sin(T)})
    assert "stands at" not in _reason(made)


# ---------------------------------------------------------------- clocks and rows


@pytest.mark.parametrize("factor", [1e-3, 1e-6, 1e3, 1e6])
@pytest.mark.parametrize("names", [("yaw_rad",), ("x_m",)])
def test_times_in_another_unit_are_doubted(factor: float, names: tuple[str, ...]) -> None:
    made = _import({name: _track()[name] for name in names}, time=factor * T)
    assert made.data["verdict"]["level"] != "good"
    assert "state the unit" in _reason(made)


def test_the_rate_of_rounded_stamps_is_that_of_the_whole_record() -> None:
    for rate in (120.0, 60.0, 24.0, 90.0):
        made = _import({"yaw_rad": YAW}, time=np.round(np.arange(N) / rate, 3))
        assert made.data["median_rate_hz"] == pytest.approx(rate, rel=1e-4)
    time = (1e5 + T).astype(np.float32).astype(float)
    made = _import({"yaw_rad": YAW}, time=time)
    assert made.data["median_rate_hz"] == pytest.approx(50.0, rel=2e-4)
    assert "the clock counts in 7.812 ms" in _reason(made)


@pytest.mark.parametrize("share", [0.005, 0.02, 0.05, 0.2])
def test_late_rows_are_put_in_their_place(share: float) -> None:
    order, rng = np.arange(N), np.random.default_rng(6)
    for k in range(1, N - 1):
        if rng.random() < share and order[k] == k:
            order[[k, k + 1]] = order[[k + 1, k]]
    made = _import({"yaw_rad": YAW[order]}, time=T[order])
    assert np.array_equal(made.frame["t_s"], T)
    assert f"{np.sum(np.diff(order) < 0)} late rows are sorted by their time" in _reason(made)
    assert made.data["verdict"]["level"] == "caution"


@pytest.mark.parametrize("rows", [30, 300, 700])
def test_a_clock_that_starts_again_is_refused(rows: int) -> None:
    time = np.where(np.arange(N) < N - rows, T, T - T[N - rows] + 0.007)
    with pytest.raises(ValueError, match="the clock starts again"):
        _import({"yaw_rad": YAW}, time=time)


@pytest.mark.parametrize(("fill", "level", "unfilled"), [(np.nan, "good", 0), (0.0, "caution", 500)])
def test_rows_that_were_never_filled_are_left_out(fill: float, level: str, unfilled: int) -> None:
    end = np.arange(N) >= 1000
    columns = {name: np.where(end, fill, values) for name, values in _track().items()}
    made = _import(columns, time=np.where(end, fill, T + 3.0))
    assert made.data["samples"] == 1000
    assert made.data["verdict"]["level"] == level
    assert made.data["rows"]["unfilled"] == unfilled


# ---------------------------------------------------------------- beats


@pytest.mark.parametrize("kind", ["line", "wave", "two waves"])
def test_a_beat_whose_rate_wanders_is_found(kind: str) -> None:
    t = np.arange(1200) / 60.0
    part = t / t[-1]
    rates = {"line": 2 * part - 1, "wave": np.sin(2 * np.pi * part), "two waves": np.sin(4 * np.pi * part)}
    phase = 2 * np.pi * np.cumsum(0.65 + 0.05 * rates[kind]) / 60.0
    beat = find_beat(t, np.cos(phase) + 0.02 * np.random.default_rng(1).normal(size=len(t)))
    assert beat is not None
    low, high = beat.interval_hz
    assert low <= (phase[-1] - phase[0]) / (2 * np.pi * t[-1]) <= high
    assert 0.005 < high - low < 0.1


@pytest.mark.parametrize("hz", [0.8, pytest.param(1.2, marks=pytest.mark.slow), 1.6])
@pytest.mark.parametrize("shape", ["sine", "square"])
@pytest.mark.parametrize("rest_s", [1.5, pytest.param(6.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_rests_around_a_swim_do_not_hide_its_beat(hz: float, shape: str, rest_s: float, noise: float) -> None:
    t = np.arange(int((8.5 + 2 * rest_s) * 50)) / 50.0
    swum = np.clip(np.minimum(t - rest_s, rest_s + 8.5 - t), 0.0, 1.0)
    wave = np.sin(2 * np.pi * hz * (t - rest_s))
    if shape == "square":
        wave = np.sign(wave)
    beat = find_beat(t, np.round(0.3 * swum * wave + noise * np.random.default_rng(1).normal(size=len(t)), 4))
    assert beat is not None
    assert beat.frequency_hz == pytest.approx(hz, rel=0.005)


@pytest.mark.parametrize("names", [("lat", "lon"), ("x_m", "y_m")])
def test_a_heading_is_asked_for(names: tuple[str, str]) -> None:
    table = pd.DataFrame({"time_s": T, **dict.fromkeys(names, T), "heading_deg": T})
    assert '{source: "heading_deg", target: ASK' in guess_mapping(table).document
