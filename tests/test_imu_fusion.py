"""An inertial log and a camera's: clocks, mounting, dropouts, held-out fixes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import signal
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation, Slerp

from swimid.inertial.alignment import clock_offset
from swimid.inertial.track_imu import track_imu
from tests.conftest import Ran
from tests.generators import imu
from tests.test_imu import BAND, rms, save, table

UnderWater = tuple[Path, pd.DataFrame, Rotation]
WHERE = ["x_m", "y_m", "z_m"]


# ---------------------------------------------------------------- clocks


def test_the_interval_has_its_stated_coverage() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 16.0, 0.01)
    wave = np.sin(5 * t) + 0.5 * np.sin(11 * t)
    covered = []
    for _ in range(60):
        true = rng.uniform(-0.1, 0.1)
        seen_t = np.arange(1.0, 15.0, 0.04)
        seen = np.interp(seen_t + true, t, wave) + rng.normal(0, 0.2, len(seen_t))
        found = clock_offset(t, wave[:, None], seen_t, seen[:, None])
        assert found is not None
        covered.append(found.low_s <= true <= found.high_s)
    # 57 of 60 expected; fewer than 51 has a chance of 1 in 100
    assert sum(covered) >= 51


def test_the_standard_error_is_the_textbooks_in_coloured_noise(rng: np.random.Generator) -> None:
    """Compare with the sandwich of one regression with Bartlett weights (Newey and West 1987)."""

    def phase(time: np.ndarray) -> np.ndarray:
        return 5 * time + 0.1 * time**2

    t, seen_t = np.arange(0.0, 16.0, 0.005), np.arange(1.0, 15.0, 0.05)
    noise = signal.lfilter([1.0], [1.0, -0.8], rng.normal(0, 0.1, len(seen_t) + 50))[50:]
    seen = 0.7 * np.sin(phase(seen_t + 0.03)) + noise
    found = clock_offset(t, np.sin(phase(t))[:, None], seen_t, seen[:, None], slow_s=5.0)
    assert found is not None
    assert found.value_s == pytest.approx(0.03, abs=4 * found.stderr_s)
    at, duration = seen_t + found.value_s, np.ptp(seen_t)
    drift = np.cos(np.pi * np.outer((seen_t - seen_t[0]) / duration, np.arange(int(2 * duration / 5.0) + 1)))
    slope = found.factors[0, 0] * np.cos(phase(at)) * (5 + 0.2 * at)
    x = np.column_stack([drift, np.sin(phase(at)), slope])
    score = x * (seen - x @ np.linalg.lstsq(x, seen, rcond=None)[0])[:, None]
    middle = score.T @ score
    for lag in range(1, 21):  # up to 1 s
        product = score[lag:].T @ score[:-lag]
        middle += (1 - lag / 21) * (product + product.T)
    bread = np.linalg.inv(x.T @ x)
    # 0.5 %: the reference is interpolated
    assert found.stderr_s == pytest.approx(np.sqrt((bread @ middle @ bread)[-1, -1]), rel=0.01)


def test_a_mount_that_may_turn_as_the_clock_does_leaves_the_offset_unknown(rng: np.random.Generator) -> None:
    """A circle turned about its centre is the same circle at another time."""
    t, seen_t = np.arange(0.0, 16.0, 0.005), np.arange(1.0, 15.0, 0.05)
    circle = np.column_stack([np.sin(5 * t), np.cos(5 * t)])
    seen = np.sin(5 * seen_t) + rng.normal(0, 0.05, len(seen_t))
    found = clock_offset(t, circle, seen_t, seen[:, None])
    assert found is None or found.stderr_s > 2 * np.pi / 5


@pytest.mark.slow
@pytest.mark.parametrize(("with_yaw", "off"), [(True, 0.002), (False, 0.010)], ids=["yaw", "path alone"])
def test_an_offset_of_37_ms_is_found(
    with_yaw: bool, off: float, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    rng = np.random.default_rng(4)
    run = imu.marching(rng)
    log = save(tmp_path / "imu.csv", run.columns())
    seen = save(tmp_path / "camera.csv", imu.camera(run, rng, offset_s=0.037, with_yaw=with_yaw))
    ran = swimid("track", "imu", log, "--with", seen, "-o", tmp_path / "run.csv", "--json")
    assert ran.status == 0
    fusion = ran.json["result"]["fusion"]
    low, high = fusion["clock_offset_95_s"]
    print(f"offset {1e3 * fusion['clock_offset_s']:.2f} ms (95 %: {1e3 * low:.2f} ... {1e3 * high:.2f})")
    assert abs(fusion["clock_offset_s"] - 0.037) < off
    assert low <= 0.037 <= high
    assert "SWM083" in [w["code"] for w in ran.json["warnings"]]
    found = table(tmp_path / "run.csv")
    away = found[WHERE[:2]].to_numpy() - run.position[:, :2]
    assert rms(away) < 0.002  # the camera alone: 1 mm in each of two coordinates
    inside = np.abs(away) <= BAND * found[["x_sd_m", "y_sd_m"]].to_numpy()
    assert inside.mean() >= 0.85


# ---------------------------------------------------------------- fusing


@pytest.mark.slow
def test_the_band_grows_in_a_gap_of_the_camera(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """The camera sees nothing for 3 s in mid swim, half a robot's way."""
    rng = np.random.default_rng(6)
    run = imu.marching(rng)
    hole = (11.0, 14.0)
    log = save(tmp_path / "imu.csv", run.columns())
    seen = save(tmp_path / "camera.csv", imu.camera(run, rng, offset_s=0.037, lost=hole))
    assert swimid("track", "imu", log, "--with", seen, "-o", tmp_path / "run.csv").status == 0
    found = table(tmp_path / "run.csv")
    lost = ((found.t_s > hole[0]) & (found.t_s < hole[1])).to_numpy()
    away = np.abs(found[WHERE[:2]].to_numpy() - run.position[:, :2])
    sd = found[["x_sd_m", "y_sd_m"]].to_numpy()
    print(f"in the hole: rms {rms(away[lost]):.4f} m, band at most ± {BAND * sd[lost].max():.4f} m")
    assert (away[lost] <= BAND * sd[lost]).mean() >= 0.9
    assert sd[lost].max() > 3 * np.median(sd[~lost])
    assert rms(away[lost]) < 0.03
    middle = np.argmax(sd[:, 0] * lost)
    assert abs(found.t_s[middle] - np.mean(hole)) < 0.8  # widest in the middle of the hole


@pytest.mark.slow
def test_mounting_and_lever_from_three_angles(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """A sensor turned by 90 degrees about the vertical, 12 cm ahead of what the camera follows."""
    rng = np.random.default_rng(8)
    run = imu.marching(rng, roll_rad=0.2, errors=imu.Errors(tilt=0.0))
    turn = Rotation.from_euler("z", 90, degrees=True)
    columns = run.columns()
    for names in (("ax_m_s2", "ay_m_s2", "az_m_s2"), ("wx_rad_s", "wy_rad_s", "wz_rad_s")):
        columns |= dict(
            zip(names, turn.inv().apply(np.column_stack([columns[n] for n in names])).T, strict=True)
        )
    body = Rotation.from_matrix(run.attitude)
    ahead = np.array([0.12, 0.0, 0.0])
    place = run.position - body.apply(ahead)
    rows = np.arange(10, len(run.time_s) - 10, 3)
    noisy = Rotation.from_rotvec(rng.normal(0, 0.004, (len(rows), 3))) * body[rows]
    q = noisy.as_quat()
    camera = {"t_s": run.time_s[rows] - 0.02}
    camera |= dict(zip(WHERE, (place[rows] + rng.normal(0, 0.001, (len(rows), 3))).T, strict=True))
    camera |= dict(zip(("qx", "qy", "qz", "qw"), q.T, strict=True))
    log, seen = save(tmp_path / "imu.csv", columns), save(tmp_path / "camera.csv", camera)
    ran = swimid("track", "imu", log, "--with", seen, "-o", tmp_path / "run.csv", "--json")
    assert ran.status == 0
    told = ran.json["result"]["mounting"]
    assert "swapped or flipped axes" in [f["fault"] for f in ran.json["result"]["faults"]]
    off = Rotation.from_rotvec(told["body_to_sensor_rotation_vector_rad"]) * turn
    assert off.magnitude() < np.radians(1.5)
    sd = np.array(told["lever_sd_m"])
    assert (np.abs(np.array(told["lever_m"]) - ahead) <= 3 * sd + 0.01).all()
    assert abs(ran.json["result"]["fusion"]["clock_offset_s"] - 0.02) < 0.002
    # a pitch that is positive nose down is changed or refused, never used as it is
    roll, pitch, yaw = noisy.as_euler("xyz").T
    angles = {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": np.unwrap(yaw)}
    kept = {name: values for name, values in camera.items() if not name.startswith("q")}
    down = save(tmp_path / "down.csv", kept | angles)
    ran = swimid("track", "imu", log, "--with", down, "-o", tmp_path / "down_run.csv", "--json")
    assert ran.status == 3 or "sign of pitch" in [f["fault"] for f in ran.json["result"]["faults"]]
    # an axis mirrored in one of the logs cannot be a mounting
    columns["wx_rad_s"] = -columns["wx_rad_s"]
    columns["ax_m_s2"] = -columns["ax_m_s2"]
    flipped = save(tmp_path / "flipped.csv", columns)
    assert swimid("track", "imu", flipped, "--with", seen, "-o", tmp_path / "x.csv").status in (3, 4)


@pytest.mark.slow
def test_logs_of_two_trials_are_refused(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    run = imu.marching(rng)
    log = save(tmp_path / "imu.csv", run.columns())
    n = 700
    drift = {"t_s": np.arange(n) / 30, "x_m": rng.normal(0, 0.01, n), "y_m": rng.normal(0, 0.01, n)}
    ran = swimid(
        "track", "imu", log, "--with", save(tmp_path / "camera.csv", drift), "-o", tmp_path / "run.csv"
    )
    assert ran.status == 4
    pixels = {"t_s": drift["t_s"], "x_px": drift["x_m"]}
    ran = swimid(
        "track", "imu", log, "--with", save(tmp_path / "pixels.csv", pixels), "-o", tmp_path / "run.csv"
    )
    assert ran.status == 3
    assert "x_m" in ran.err


@pytest.mark.parametrize(("places", "status"), [(True, 0), (False, 4)], ids=["positions", "nothing else"])
def test_roll_alone_is_not_compared(
    places: bool, status: int, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    run = imu.marching(rng, swim_s=6.0, rest_s=1.5, rate_hz=50.0)
    seen = imu.camera(run, rng, with_yaw=False)
    seen["roll_rad"] = 0.05 * np.sin(7.5 * seen["t_s"])
    if not places:
        del seen["x_m"], seen["y_m"]
    log, camera = save(tmp_path / "imu.csv", run.columns()), save(tmp_path / "camera.csv", seen)
    assert swimid("track", "imu", log, "--with", camera, "-o", tmp_path / "run.csv").status == status


# ---------------------------------------------------------------- real recordings


@pytest.fixture(scope="module")
def under_water(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> UnderWater:
    """The inertial log, and the camera's path from the marker it saw.

    The file holds the marker seen from the camera, whose axes are the sensor's (y up). The path of the
    camera is minus that, turned to the world by the sensor's attitude (a plain filter, not swimid's).
    """
    import vqf

    folder = real_data / "underwater_imu"
    sensor, seen = np.loadtxt(folder / "imu.txt"), np.loadtxt(folder / "image.txt")
    names = ["ax_m_s2", "ay_m_s2", "az_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s"]
    path = tmp_path_factory.mktemp("underwater") / "imu.csv"
    pd.DataFrame(sensor, columns=["t_s", *names]).to_csv(path, index=False)
    grid = np.arange(sensor[0, 0], sensor[-1, 0], 1e-3)
    even = np.column_stack([np.interp(grid, sensor[:, 0], c) for c in sensor[:, 1:].T])
    q = vqf.offlineVQF(np.ascontiguousarray(even[:, 3:]), np.ascontiguousarray(even[:, :3]), None, 1e-3)[
        "quat6D"
    ]
    turn = Slerp(grid, Rotation.from_quat(q[:, [1, 2, 3, 0]]))
    # the camera is late by about 0.2 s, in which the attitude changes by less than 0.3 deg
    turned = turn(np.clip(seen[:, 0] + 0.2, grid[0], grid[-1]))
    place = -turned.apply(seen[:, 2:5])
    marker = Rotation.from_quat(seen[:, 5:9])  # to the camera
    # how the marker hangs in the world: the mean over the record
    attitude = (turned * marker).mean() * marker.inv()
    return path, pd.DataFrame({"t_s": seen[:, 0], **dict(zip(WHERE, place.T, strict=True))}), attitude


@pytest.mark.slow
def test_held_out_fixes_under_water(
    under_water: UnderWater, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    log, optical, _ = under_water
    optical[::2].to_csv(tmp_path / "half.csv", index=False)
    ran = swimid("track", "imu", log, "--with", tmp_path / "half.csv", "-o", tmp_path / "run.csv", "--json")
    assert ran.status == 0
    fusion = ran.json["result"]["fusion"]
    found = table(tmp_path / "run.csv")
    held = optical[1::2]
    when = held.t_s + fusion["clock_offset_s"]
    inside = (when < found.t_s.iloc[-1]).to_numpy()
    error = np.column_stack([np.interp(when, found.t_s, found[c]) - held[c] for c in WHERE])[inside]
    print(
        f"held-out fixes: rms {1e3 * rms(error):.2f} mm over {len(error)}, "
        f"clock {1e3 * fusion['clock_offset_s']:.1f} ms"
    )
    assert rms(error) < 0.02


@pytest.mark.slow
def test_velocity_between_fixes_two_seconds_apart(
    under_water: UnderWater, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    """Against the trapezoid, begun anew at each fix from the velocity and the attitude the camera saw.

    Both are held against the derivative of the camera's path at 25 Hz, which is itself off by some 10 mm/s
    (water between camera and marker, noise): with a filter's attitude in place of the camera's the trapezoid
    is good to 40 mm/s over 2 s, no more than 2.5 times as bad.
    """
    log, optical, attitude = under_water
    every = save(tmp_path / "every.csv", dict(optical))
    ran = swimid("track", "imu", log, "--with", every, "-o", tmp_path / "reference.csv", "--json")
    offset = ran.json["result"]["fusion"]["clock_offset_s"]
    sparse = save(tmp_path / "sparse.csv", dict(optical[::50]))
    options = ["--clock-offset-s", offset, "--fix-sd-m", 0.001, "--rest", "all"]
    assert swimid("track", "imu", log, "--with", sparse, *options, "-o", tmp_path / "run.csv").status == 0
    found, sensor = table(tmp_path / "run.csv"), pd.read_csv(log)
    t, seen_t = sensor.t_s.to_numpy(), optical.t_s.to_numpy() + offset
    force = sensor[["ax_m_s2", "ay_m_s2", "az_m_s2"]].to_numpy()
    rate = sensor[["wx_rad_s", "wy_rad_s", "wz_rad_s"]].to_numpy()
    # cubics over half a second of the camera's path
    derived = signal.savgol_filter(optical[WHERE].to_numpy(), 13, 3, deriv=1, delta=0.04, axis=0)
    true = np.column_stack([np.interp(t, seen_t, c) for c in derived.T])
    estimate = np.column_stack([np.interp(t, found.t_s, found[f"v{a}_m_s"]) for a in "xyz"])
    plain, fused = [], []
    for k in range(0, len(optical) - 50, 50):
        rows = (t >= seen_t[k]) & (t < seen_t[k + 50])
        if rows.sum() < 1000:
            continue
        steps = np.diff(t[rows], prepend=t[rows][0])[:, None] * rate[rows]
        turned = Rotation.from_rotvec(np.cumsum(steps, axis=0))  # the body turns by a few degrees at most
        acceleration = (attitude[k] * turned).apply(force[rows]) - [0.0, 0.0, 9.80665]
        way = cumulative_trapezoid(acceleration, t[rows], axis=0, initial=0)
        plain.append(derived[k] + way - true[rows])
        fused.append((estimate - true)[rows])
    ours, theirs = rms(np.vstack(fused)), rms(np.vstack(plain))
    ratio = theirs / ours
    print(f"velocity rms: fused {1e3 * ours:.1f} mm/s, trapezoid {1e3 * theirs:.1f} mm/s, {ratio:.1f}x")
    assert theirs >= 3 * ours


@pytest.mark.slow
@pytest.mark.parametrize("stray", [-9999.0, 3.0])
def test_a_stray_fix_is_removed(swimid: Callable[..., Ran], tmp_path: Path, stray: float) -> None:
    """One mark for "no sample", or one wrong blob, among the camera's positions."""
    run = imu.marching(np.random.default_rng(8), swim_s=8.0, rest_s=2.5, rate_hz=50.0)
    log = save(tmp_path / "imu.csv", run.columns())
    seen = {"t_s": run.time_s, "x_m": run.position[:, 0].copy(), "y_m": run.position[:, 1]}
    seen["x_m"][300] = stray
    camera = save(tmp_path / "camera.csv", {name: values[::3] for name, values in seen.items()})
    ran = swimid("track", "imu", log, "--with", camera, "-o", tmp_path / "run.csv")
    assert ran.status == 0, ran.err
    assert "SWM058" in ran.err
    error = table(tmp_path / "run.csv").x_m - run.position[:, 0]
    assert np.sqrt(np.mean(error**2)) < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("edge_s", [0.006, 0.1])
def test_bands_beside_an_accurate_camera_are_those_of_the_errors(edge_s: float) -> None:
    """A planar swim after a rest of 1.5 s, by forward Euler steps; the sensor is 0.1 m behind the marker."""
    rng, step, rest = np.random.default_rng(1), 1 / 5000, 1.5
    t = np.arange(0.0, 12.0, step)
    phase, steep = 2 * np.pi * 1.2 * (t - rest), 1 / (np.pi * 1.2 * edge_s)
    on = np.clip((t - rest) / 0.05, 0, 1)
    push = np.array([np.tanh(steep * np.sin(phase + p)) for p in (0.0, 0.8)]) * on
    thrust = on * (0.35 + 0.8 * np.maximum(0.0, np.tanh(steep * np.sin(2 * phase + 0.3))))
    u = v = r = 0.0
    rows = []
    for a, b, c in zip(6.0 * push[0], push[1], thrust, strict=True):
        rates = c - 2.5 * u * abs(u) + v * r, b - 4 * v - u * r, a - 3 * r
        rows.append((u, v, r, *rates))
        u, v, r = u + step * rates[0], v + step * rates[1], r + step * rates[2]
    u, v, r, du, dv, dr = np.array(rows).T
    yaw = 0.3 + step * np.cumsum(r)
    x = 0.5 + step * np.cumsum(u * np.cos(yaw) - v * np.sin(yaw))
    y = 0.8 + step * np.cumsum(u * np.sin(yaw) + v * np.cos(yaw))
    at = slice(None, None, 50)
    force = np.column_stack([du - v * r + 0.1 * r**2, dv + u * r - 0.1 * dr, np.full(len(t), 9.80665)])[at]
    force += 0.05 * rng.normal(size=3) + 0.039 * rng.normal(size=force.shape)
    turn = np.column_stack([0 * r, 0 * r, r])[at]
    turn += 0.003 * rng.normal(size=3) + 0.0017 * rng.normal(size=turn.shape)
    names = ("ax_m_s2", "ay_m_s2", "az_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s")
    imu_log = pd.DataFrame({"t_s": t[at], **dict(zip(names, np.hstack([force, turn]).T, strict=True))})
    seen = np.arange(0.4, 11.7, 1 / 30)
    noise = {"x_m": (x, 2e-4), "y_m": (y, 2e-4), "yaw_rad": (yaw, 2e-3)}
    camera = {n: np.interp(seen, t, z) + sd * rng.normal(size=len(seen)) for n, (z, sd) in noise.items()}
    made = track_imu(imu_log, other=pd.DataFrame({"t_s": seen - 3.09312, **camera}))
    assert len(made.data["still_periods"]) == 1
    assert made.data["mounting"]["lever_m"][0] == pytest.approx(-0.1, abs=0.003)
    inside = slice(100, 1100)
    for name, truth in (("x", x), ("y", y)):
        off = (made.frame[f"{name}_m"].to_numpy() - truth[at])[inside]
        sd = made.frame[f"{name}_sd_m"].to_numpy()[inside]
        assert np.sqrt(np.mean(off**2)) < 2.5e-4
        assert 0.6 < np.sqrt(np.mean((off / sd) ** 2)) < 1.6
    assert made.verdict != "bad"
