"""Tests that each fault of an inertial recording is found, named, and repaired or refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from swimid.errors import InputError
from swimid.inertial import faults
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import ImuRecord, find_mount, find_rests
from tests.conftest import Ran
from tests.generators import imu

G = 9.80665


@pytest.fixture(scope="module")
def run() -> imu.Run:
    """A run that tilts enough for its axes to be told apart."""
    return imu.marching(np.random.default_rng(3), roll_rad=0.25, swim_s=12.0, rest_s=2.0)


def record(run: imu.Run) -> ImuRecord:
    return ImuRecord(run.time_s, run.acceleration.copy(), run.rate.copy(), name="imu.csv")


def names(findings: list[faults.Finding]) -> list[str]:
    return [f.fault for f in findings if f.verdict == "handled"]


def test_a_sound_record_has_no_fault(run: imu.Run) -> None:
    repaired, found = faults.repair(record(run))
    assert names(found) == []
    np.testing.assert_array_equal(repaired.acceleration, run.acceleration)


@pytest.mark.parametrize(("unit", "factor"), [("g", 1 / G), ("mg", 1e3 / G), ("ft/s2", 1 / 0.3048)])
def test_accelerations_in_another_unit_are_converted(run: imu.Run, unit: str, factor: float) -> None:
    repaired, found = faults.repair(replace(record(run), acceleration=run.acceleration * factor))
    assert names(found) == ["acceleration unit"]
    assert f" {unit} " in found[0].text
    np.testing.assert_allclose(repaired.acceleration, run.acceleration, rtol=1e-9)


@pytest.mark.parametrize("factor", [0.01, 2.0])
def test_accelerations_of_no_known_unit_are_refused(run: imu.Run, factor: float) -> None:
    with pytest.raises(InputError, match="gravity alone gives"):
        faults.repair(replace(record(run), acceleration=run.acceleration * factor))


@pytest.mark.parametrize("quaternions", [False, True])
def test_turn_rates_in_degrees_are_converted(run: imu.Run, quaternions: bool) -> None:
    given = replace(
        record(run), rate=np.degrees(run.rate), quaternion=run.quaternion if quaternions else None
    )
    repaired, found = faults.repair(given)
    assert names(found) == ["turn-rate unit"]
    np.testing.assert_allclose(repaired.rate, run.rate, rtol=1e-9)


def test_the_stated_unit_of_fast_turns_about_the_vertical_stays(rng: np.random.Generator) -> None:
    """Without tilt the unit of 40 rad/s is doubted, and kept as stated."""
    n = 1000
    level = rng.normal(0, 0.01, (n, 3)) + np.array([0, 0, G])
    turning = rng.normal(0, 0.1, (n, 3))
    turning = turning + np.outer(40 * np.sin(np.arange(n) / 50), [0, 0, 1])
    repaired, found = faults.repair(ImuRecord(np.arange(n) / 100, level, turning))
    assert "unconfirmed turn rates" in names(found)
    np.testing.assert_array_equal(repaired.rate, turning)


@pytest.mark.parametrize(
    ("rows", "value"),
    [
        ([500], -9999.0),
        (range(500, 580), -9999.0),
        ([300, 600, 601], -1e300),
        ([500], 300.0),
        ([700], 65535.0),
    ],
)
@pytest.mark.parametrize("axis", [0, 5])
def test_wild_readings_are_interpolated(run: imu.Run, axis: int, rows: list[int], value: float) -> None:
    both = np.hstack([run.acceleration, run.rate])
    both[list(rows), axis] = value
    repaired, found = faults.repair(replace(record(run), acceleration=both[:, :3], rate=both[:, 3:]))
    assert names(found) == ["wild readings"]
    assert found[0].count == len(list(rows))
    true = np.hstack([run.acceleration, run.rate])[:, axis]
    assert np.ptp(np.hstack([repaired.acceleration, repaired.rate])[:, axis]) <= np.ptp(true)


@pytest.mark.parametrize(("axis", "value"), [(0, 0.0), (4, 0.0), (2, 9.81), (5, 0.013)])
def test_a_dead_channel_is_refused(run: imu.Run, axis: int, value: float) -> None:
    both = np.hstack([run.acceleration, run.rate])
    both[:, axis] = value
    column = ("ax_m_s2", "ay_m_s2", "az_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s")[axis]
    with pytest.raises(InputError, match=f"'{column}': 100.0 % of the samples are stuck"):
        faults.repair(replace(record(run), acceleration=both[:, :3], rate=both[:, 3:]))


def test_a_channel_stuck_for_a_while_is_bridged(run: imu.Run) -> None:
    rate = run.rate.copy()
    rate[700:800, 1] = rate[700, 1]
    repaired, found = faults.repair(replace(record(run), rate=rate))
    assert names(found) == ["dead channel"]
    assert repaired.filled[710:790, 1].all()
    assert not repaired.filled[:690, 1].any()


def test_a_dead_magnetometer_and_dead_quaternions_are_not_used(run: imu.Run) -> None:
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(run.time_s), 1))
    given = replace(record(run), magnetic=np.zeros_like(run.rate), quaternion=still)
    repaired, found = faults.repair(given)
    assert names(found) == ["dead magnetometer", "dead quaternions"]
    assert repaired.magnetic is None
    assert repaired.quaternion is None


def test_clipped_samples_are_bridged_and_many_are_refused(run: imu.Run) -> None:
    limit = 0.97 * run.rate[:, 0].max()
    repaired, found = faults.repair(replace(record(run), rate=np.minimum(run.rate, limit)))
    assert names(found) == ["saturated channel"]
    clipped = run.rate >= limit
    assert repaired.filled[:, 1][clipped.any(axis=1)].all()
    with pytest.raises(InputError, match="clipped"):
        faults.repair(replace(record(run), rate=np.minimum(run.rate, 0.5 * limit)))


def test_repeated_samples_are_bridged(run: imu.Run, rng: np.random.Generator) -> None:
    """A fifth of the samples show the one before again."""
    source = np.arange(len(run.time_s))
    again = rng.random(len(source)) < 0.2
    again[0] = False
    source = np.maximum.accumulate(np.where(again, 0, source))
    repaired, found = faults.repair(
        replace(record(run), acceleration=run.acceleration[source], rate=run.rate[source])
    )
    assert names(found) == ["repeated samples"]
    assert found[0].count == again.sum()
    np.testing.assert_array_equal(repaired.filled[:, 1], again)


def test_repeated_and_swapped_stamps_are_put_in_order(run: imu.Run) -> None:
    rows = np.arange(len(run.time_s))
    rows = np.insert(rows, 500, 499)
    rows[[800, 801]] = rows[[801, 800]]
    repaired, found = faults.repair(record(run).take(rows))
    assert names(found) == ["repeated stamps"]
    np.testing.assert_array_equal(repaired.time_s, run.time_s)


def test_a_clock_that_was_reset_is_refused(run: imu.Run) -> None:
    time = run.time_s.copy()
    time[800:] -= 5.0
    with pytest.raises(InputError, match="time goes back"):
        faults.repair(replace(record(run), time_s=time))


def test_dropped_samples_are_counted(run: imu.Run) -> None:
    keep = np.ones(len(run.time_s), dtype=bool)
    keep[400:410] = keep[900] = False
    _, found = faults.repair(record(run).take(keep))
    assert names(found) == ["dropped samples"]
    assert found[0].count == 11


def test_a_long_hole_is_refused(run: imu.Run) -> None:
    keep = (run.time_s < 5) | (run.time_s > 7.5)
    with pytest.raises(InputError, match="no samples for"):
        faults.repair(record(run).take(keep))


def test_clock_jitter_is_reported(run: imu.Run, rng: np.random.Generator) -> None:
    time = run.time_s + rng.uniform(-0.003, 0.003, len(run.time_s))
    _, found = faults.repair(replace(record(run), time_s=time))
    assert "clock jitter" in names(found)


def test_missing_cells_are_bridged_and_too_many_refused(run: imu.Run) -> None:
    rate = run.rate.copy()
    rate[300:305, 2] = np.nan
    repaired, found = faults.repair(replace(record(run), rate=rate))
    assert names(found) == ["missing cells"]
    assert np.isfinite(repaired.rate).all()
    rate[: len(rate) // 2 + 10] = np.nan
    with pytest.raises(InputError, match="missing"):
        faults.repair(replace(record(run), rate=rate))


@pytest.mark.parametrize(
    ("order", "signs"),
    [((1, 0, 2), (1, 1, 1)), ((0, 1, 2), (-1, 1, 1)), ((0, 2, 1), (1, 1, -1)), ((0, 1, 2), (-1, -1, -1))],
)
def test_wrong_gyroscope_axes_are_rearranged(
    order: tuple[int, ...], signs: tuple[int, ...], rng: np.random.Generator
) -> None:
    """A body shaken about all axes: roll and pitch large, so every gyroscope axis turns gravity."""
    n = 4000
    t = np.arange(n) / 100
    roll, pitch, yaw = 0.6 * np.sin(1.1 * t), 0.5 * np.sin(1.7 * t + 1), 0.8 * np.sin(0.6 * t)
    turn = imu.cosines(roll, pitch, yaw)
    spin = np.einsum("nji,njk->nik", turn, np.gradient(turn, 0.01, axis=0))
    rate = np.column_stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]])
    force = np.einsum("nji,nj->ni", turn, np.tile([0.0, 0.0, -G], (n, 1))) + rng.normal(0, 0.05, (n, 3))
    rate = rate + rng.normal(0, 0.005, (n, 3))
    # naval axes stay: the comparison knows no frame but that gravity turns against the body
    wrong = rate[:, order] * signs
    given = ImuRecord(t, force, wrong)
    repaired, found = faults.repair(given)
    assert names(found) == ["swapped or flipped axes"]
    np.testing.assert_allclose(repaired.rate, rate, atol=1e-12)


def test_gravity_along_another_axis_is_handled_and_upside_down_refused(run: imu.Run) -> None:
    side = replace(record(run), acceleration=run.acceleration[:, [0, 2, 1]] * [1, 1, -1])
    mount, found = find_mount(side, [], TrackImuOptions())
    assert names(found) == ["gravity axis"]
    assert "+y" in found[0].text
    up = mount.rotation.inv().apply(side.acceleration.mean(axis=0))
    assert up[2] > 0.9 * G
    with pytest.raises(InputError, match="az is negative"):
        find_mount(replace(record(run), acceleration=-run.acceleration), [], TrackImuOptions())


@pytest.mark.parametrize("fault", ["g", "deg", "dead", "clipped", "reset"])
def test_the_command_reports_a_fault(
    fault: str, run: imu.Run, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    columns = run.columns()
    if fault == "g":
        columns |= {n: columns[n] / G for n in ("ax_m_s2", "ay_m_s2", "az_m_s2")}
    elif fault == "deg":
        columns |= {n: np.degrees(columns[n]) for n in ("wx_rad_s", "wy_rad_s", "wz_rad_s")}
    elif fault == "dead":
        columns["wy_rad_s"] = np.zeros_like(run.time_s)
    elif fault == "clipped":
        columns["wx_rad_s"] = np.minimum(columns["wx_rad_s"], 0.97 * columns["wx_rad_s"].max())
    else:
        columns["t_s"] = np.where(run.time_s > 8, run.time_s - 5, run.time_s)
    pd.DataFrame(columns).to_csv(tmp_path / "imu.csv", index=False)
    ran = swimid("track", "imu", tmp_path / "imu.csv", "-o", tmp_path / "run.csv", "--json")
    if fault in ("dead", "reset"):
        assert ran.status == 3
        assert ran.json["error"]["column"] in ("wy_rad_s", "t_s")
        assert not (tmp_path / "run.csv").exists()
    else:
        assert ran.status == 0
        assert "SWM080" in [w["code"] for w in ran.json["warnings"]]


def test_a_missing_column_is_named(swimid: Callable[..., Ran], tmp_path: Path, run: imu.Run) -> None:
    pd.DataFrame(run.columns()).drop(columns="wz_rad_s").to_csv(tmp_path / "imu.csv", index=False)
    ran = swimid("track", "imu", tmp_path / "imu.csv", "-o", tmp_path / "run.csv")
    assert ran.status == 3
    assert "wz_rad_s" in ran.err


# ---------------------------------------------------------------- single readings, by hand


def test_single_corrupt_readings_in_a_rest_are_interpolated(run: imu.Run, rng: np.random.Generator) -> None:
    """A rest continues over a corrupt reading, and a record without one in its rests stays as it is."""
    acceleration = run.acceleration.copy()
    rows = [50, 100, 150, *rng.choice(np.arange(400, 1000), 5, replace=False)]
    acceleration[rows, 2] -= 2.56
    repaired, found = faults.repair(replace(record(run), acceleration=acceleration))
    assert "corrupt readings" in names(found)
    assert repaired.filled[rows, 0].all()
    assert np.abs(repaired.acceleration[[50, 100, 150], 2] - G).max() < 0.3
    assert find_rests(repaired)[0].at == "start"
    only = run.acceleration.copy()
    only[600, 2] -= 2.56
    assert "corrupt readings" not in names(faults.repair(replace(record(run), acceleration=only))[1])


@pytest.mark.parametrize("norm", [1.0, 2.2])
def test_single_corrupt_quaternions_are_interpolated(run: imu.Run, norm: float) -> None:
    quaternion = run.quaternion.copy()
    quaternion[[100, 500, 501, 700]] = norm * np.array([0.5, 0.5, 0.5, 0.5])
    repaired, found = faults.repair(replace(record(run), quaternion=quaternion))
    assert names(found) == ["corrupt quaternions"]
    assert found[-1].count == 4
    assert repaired.quaternion is not None
    same = np.abs(np.sum(repaired.quaternion * run.quaternion, axis=1))
    assert np.degrees(2 * np.arccos(np.clip(same, 0, 1))).max() < 3.0
