"""Tests of ``swimid track imu`` against simulated truth and against optical references."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pytest
from scipy import io, signal
from scipy.spatial.transform import Rotation

from swimid.inertial import estimate
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import ImuRecord, find_rests, integrate_attitude, measure_noise, prepare_setup
from swimid.inertial.smoother import at_reference
from swimid.inertial.track_imu import compute_by_paper
from swimid.kinematics.attitude import angles, from_angles
from tests.conftest import Ran
from tests.generators import imu

AXES = "xyz"
VELOCITY = [f"v{a}_m_s" for a in AXES]
#: Standard deviations a 95 % band reaches.
BAND = 1.96


def save(path: Path, columns: dict[str, np.ndarray], **metadata: object) -> Path:
    with path.open("w", encoding="utf-8") as stream:
        stream.writelines(f"# {key}: {value}\n" for key, value in metadata.items())
        pd.DataFrame(columns).to_csv(stream, index=False)
    return path


def table(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, comment="#")


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


# ---------------------------------------------------------------- parts


def test_angles_and_their_inverse_agree(rng: np.random.Generator) -> None:
    given = rng.uniform(-1.2, 1.2, (3, 50))
    back = np.array(angles(from_angles(*given)))
    np.testing.assert_allclose(back[:2], given[:2], atol=1e-12)
    np.testing.assert_allclose(np.exp(1j * back[2]), np.exp(1j * given[2]), atol=1e-12)


def test_attitude_of_a_cone_drifts_only_by_the_error_of_the_trapezoid() -> None:
    """Integrate a coning motion, the classical test of attitude integration."""
    t = np.arange(0.0, 10.0, 0.01)
    half, spin = 0.1, 2 * np.pi
    true = Rotation.from_rotvec(np.column_stack([half * np.cos(spin * t), half * np.sin(spin * t), 0 * t]))
    fine = np.arange(0.0, 10.0, 1e-4)
    dense = Rotation.from_rotvec(
        np.column_stack([half * np.cos(spin * fine), half * np.sin(spin * fine), 0 * fine])
    )
    steps = (dense[:-1].inv() * dense[1:]).as_rotvec() / 1e-4
    rate = np.column_stack([np.interp(t, fine[:-1] + 5e-5, c) for c in steps.T])
    found = integrate_attitude(t, rate, true[0])
    # the trapezoid takes (spin dt)^2 / 12 off the amplitude of a sine: the cone's own turning,
    # half^2 spin / 2
    # a second, is off by twice that; without the coning term it would be twice as much again
    drift = half**2 * spin * (spin * 0.01) ** 2 / 12 * 10.0
    assert (found[-5].inv() * true[-5]).magnitude() < 1.1 * drift


def test_noise_and_rests_of_a_known_sensor(rng: np.random.Generator) -> None:
    run = imu.marching(rng)
    record = ImuRecord(run.time_s, run.acceleration, run.rate)
    rests = find_rests(record)
    assert [r.at for r in rests] == ["start", "end"]
    assert record.time_s[rests[0].last] == pytest.approx(4.0, abs=0.6)
    noise = measure_noise(record, rests)
    # 3 x 800 differences: the deviation of a deviation is 1/sqrt(2 n), doubled for their correlation
    assert noise.acceleration_m_s2_per_rt_hz == pytest.approx(imu.Errors().acceleration_noise, rel=0.1)
    assert noise.rate_rad_s_per_rt_hz == pytest.approx(imu.Errors().rate_noise, rel=0.1)


@pytest.mark.parametrize("mode", ["marching", "receding", "rotating"])
def test_the_steps_of_the_paper(mode: Literal["marching", "receding", "rotating"]) -> None:
    """Compare with four samples computed by hand: constant part, threshold, Eqs 10 to 13."""
    t = np.array([0.0, 0.1, 0.2, 0.3])
    acceleration = np.array([[1.0, 0, 9.8], [3.0, 0, 9.8], [-1.0, 0, 9.81], [-3.0, 0, 9.79]])
    rate = np.column_stack([np.zeros(4), np.zeros(4), [0.5, 0.5, 0.7, 0.3]])
    quarter = Rotation.from_rotvec(np.tile([0, 0, np.pi / 2], (4, 1)))
    options = TrackImuOptions(motion_mode=mode, threshold_m_s2=0.02, threshold_rad_s=0.01)
    found, constant = compute_by_paper(ImuRecord(t, acceleration, rate), quarter, options)
    np.testing.assert_allclose(found["acceleration"][:, 1], [1, 3, -1, -3], atol=1e-12)
    np.testing.assert_allclose(found["acceleration"][:, 2], 0, atol=1e-12)  # 0.01 is below the threshold
    np.testing.assert_allclose(found["velocity"][:, 1], [0, 0.2, 0.3, 0.1], atol=1e-12)
    np.testing.assert_allclose(found["position"][:, 1], [0, 0.01, 0.035, 0.055], atol=1e-12)
    kept = 0.5 if mode == "rotating" else 0.0
    assert found["rate"][0, 2] == pytest.approx(kept)
    np.testing.assert_allclose(constant, [0, 0, 9.8, 0, 0, 0.5 - kept], atol=1e-12)


# ---------------------------------------------------------------- simulated runs


@pytest.mark.slow
@pytest.mark.parametrize("quaternions", [False, True])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_smoother_is_three_times_as_good_as_the_paper(
    seed: int, quaternions: bool, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    """Bias, a tilt of 2 degrees and the noise of a 3DM-GX1; and its band holds the truth."""
    run = imu.marching(np.random.default_rng(seed))
    log = save(tmp_path / "imu.csv", run.columns(quaternions=quaternions))
    errors = {}
    for method in ("smoother", "paper"):
        ran = swimid("track", "imu", log, "--method", method, "-o", tmp_path / f"{method}.csv")
        assert ran.status == 0
        found = table(tmp_path / f"{method}.csv")
        errors[method] = found[VELOCITY].to_numpy() - run.velocity
    print(f"velocity rms: smoother {rms(errors['smoother']):.3f}, paper {rms(errors['paper']):.3f} m/s")
    assert rms(errors["smoother"]) <= rms(errors["paper"]) / 3
    found = table(tmp_path / "smoother.csv")
    inside = np.abs(errors["smoother"]) <= BAND * found[[f"v{a}_sd_m_s" for a in AXES]].to_numpy()
    assert inside.mean() >= 0.9
    away = found[[f"{a}_m" for a in AXES]].to_numpy() - run.position
    assert (np.abs(away) <= BAND * found[[f"{a}_sd_m" for a in AXES]].to_numpy()).mean() >= 0.9


@pytest.mark.slow
def test_errors_are_as_large_as_their_bands_say() -> None:
    """Over many runs the squared errors, in their own deviations, average to about one."""
    squares = []
    for seed in range(12):
        run = imu.marching(np.random.default_rng(100 + seed), swim_s=10.0, rest_s=2.5, rate_hz=50.0)
        record = ImuRecord(run.time_s, run.acceleration, run.rate)
        setup, _ = prepare_setup(record, TrackImuOptions())
        found = at_reference(estimate.smooth_alone(setup).smoothed)
        squares.append(np.mean(((found["velocity"] - run.velocity) / found["velocity_sd"])[300:-200] ** 2))
    # 36 independent numbers: chi square over its freedom lies in 0.6 ... 1.5 in 95 of 100 cases; prior
    # biases and the drift budget are bounds, not this sensor's values, so that less than 1 is expected
    assert 0.1 < np.mean(squares) < 1.5


def test_the_result_has_the_time_up_to_which_the_path_can_be_used(
    swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator
) -> None:
    run = imu.marching(rng)
    ran = swimid(
        "track", "imu", save(tmp_path / "imu.csv", run.columns()), "-o", tmp_path / "run.csv", "--json"
    )
    until = ran.json["result"]["path_trusted"]["until_s"]
    found = table(tmp_path / "run.csv")
    half = BAND * found[["x_sd_m", "y_sd_m"]].max(axis=1)
    before = found.t_s < until
    travelled = np.hypot(found.x_m.diff(), found.y_m.diff()).fillna(0).cumsum()
    assert (half[before] <= np.maximum(0.1, 0.1 * travelled[before]) + 1e-9).all()
    assert "SWM081" in [w["code"] for w in ran.json["warnings"]]


def test_surge_within_a_stroke_needs_no_rest(
    swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator
) -> None:
    """Without any rest: the oscillation is still right, to the band it states and what sway leaks in."""
    run = imu.marching(rng)
    swum = (run.time_s > 6) & (run.time_s < 20)
    log = save(tmp_path / "imu.csv", {k: v[swum] for k, v in run.columns().items()})
    ran = swimid("track", "imu", log, "-o", tmp_path / "run.csv", "--json")
    assert "SWM082" in [w["code"] for w in ran.json["warnings"]]
    found = table(tmp_path / "run.csv")
    sos = signal.butter(2, ran.json["result"]["surge_oscillation"]["above_hz"], "high", fs=100, output="sos")
    true = signal.sosfiltfilt(sos, run.body_velocity[swum, 0])
    middle = slice(200, -200)
    assert np.std(true[middle]) > 0.01
    assert np.std(found.u_osc_m_s[middle] - true[middle]) < 0.15 * np.std(true[middle])


@pytest.mark.slow
@pytest.mark.parametrize(("stated", "wrong"), [(1.2, False), (1.8, True)])
def test_a_stated_stroke_frequency_is_checked(
    stated: float, wrong: bool, swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator
) -> None:
    run = imu.marching(rng, frequency_hz=1.2)
    ran = swimid(
        "track",
        "imu",
        save(tmp_path / "imu.csv", run.columns(), frequency_hz=stated),
        "-o",
        tmp_path / "run.csv",
        "--json",
    )
    stroke = ran.json["result"]["stroke"]
    assert abs(stroke["frequency_hz"] - 1.2) <= 3 * stroke["stderr_hz"]
    assert stroke["contradicts"] is wrong
    assert ("SWM032" in [w["code"] for w in ran.json["warnings"]]) is wrong


@pytest.mark.slow
def test_mounting_by_option_and_by_rest(
    swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator
) -> None:
    """A sensor rolled by 90 degrees, given; one tilted by a little, told by a level rest."""
    run = imu.marching(rng, errors=imu.QUIET)
    turned = Rotation.from_euler("x", 90, degrees=True).inv()
    columns = run.columns()
    for names in (("ax_m_s2", "ay_m_s2", "az_m_s2"), ("wx_rad_s", "wy_rad_s", "wz_rad_s")):
        columns |= dict(zip(names, turned.apply(np.column_stack([columns[n] for n in names])).T, strict=True))
    log = save(tmp_path / "imu.csv", columns)
    ran = swimid("track", "imu", log, "--mount-deg", 90, 0, 0, "-o", tmp_path / "run.csv")
    assert ran.status == 0
    found = table(tmp_path / "run.csv")
    error = found[["u_m_s", "v_m_s", "w_m_s"]].to_numpy() - run.body_velocity
    assert np.abs(error).max() <= BAND * 2 * found[["u_sd_m_s", "v_sd_m_s", "w_sd_m_s"]].to_numpy().max()
    tilted = imu.marching(np.random.default_rng(5))
    log = save(tmp_path / "tilted.csv", tilted.columns())
    for flag, largest in ((["--level-at-rest"], 1e-9), ([], 0.05)):
        result = swimid("track", "imu", log, *flag, "-o", tmp_path / "t.csv", "--json").json["result"]
        tilt = np.hypot(result["mounting"]["roll_at_rest_rad"], result["mounting"]["pitch_at_rest_rad"])
        assert tilt <= largest


@pytest.mark.slow
def test_a_lever_is_subtracted(swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator) -> None:
    """The reference point 0.2 m behind the sensor sways with the yaw rate."""
    run = imu.marching(rng, errors=imu.QUIET)
    log = save(tmp_path / "imu.csv", run.columns())
    for name, lever in (("at", 0.0), ("behind", 0.2)):
        assert (
            swimid("track", "imu", log, "--lever-m", lever, 0, 0, "-o", tmp_path / f"{name}.csv").status == 0
        )
    at, behind = table(tmp_path / "at.csv"), table(tmp_path / "behind.csv")
    np.testing.assert_allclose(behind.v_m_s - at.v_m_s, -0.2 * at.yaw_rate_rad_s, atol=2e-3)


def test_contradicting_options_and_bad_files_are_refused(
    swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator
) -> None:
    run = imu.marching(rng, swim_s=8.0, rest_s=1.5)
    log = save(tmp_path / "imu.csv", run.columns())
    assert (
        swimid("track", "imu", log, "--method", "paper", "--with", log, "-o", tmp_path / "o.csv").status == 2
    )
    assert swimid("track", "imu", log, "--still", 5, 1, "-o", tmp_path / "o.csv").status == 2
    assert swimid("track", "imu", tmp_path / "no.csv", "-o", tmp_path / "o.csv").status == 3
    save(tmp_path / "short.csv", {k: v[:20] for k, v in run.columns().items()})
    assert swimid("track", "imu", tmp_path / "short.csv", "-o", tmp_path / "o.csv").status == 3


# ---------------------------------------------------------------- real recordings


@pytest.mark.slow
@pytest.mark.parametrize("field", [False, True], ids=["6-axis", "9-axis"])
@pytest.mark.parametrize("name", ["15_undisturbed_fast_translation_A", "10_undisturbed_slow_translation_A"])
def test_hand_held_sensor_against_motion_capture(
    name: str, field: bool, real_data: Path, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    """Acceleration as the optical path's second derivative; the position's band holds the truth."""
    trial = io.loadmat(real_data / "broad" / f"{name}.mat", squeeze_me=True)
    rate = float(trial["sampling_rate"])
    time = np.arange(len(trial["imu_acc"])) / rate
    columns = {"t_s": time}
    columns |= {f"a{a}_m_s2": c for a, c in zip(AXES, trial["imu_acc"].T, strict=True)}
    columns |= {f"w{a}_rad_s": c for a, c in zip(AXES, trial["imu_gyr"].T, strict=True)}
    if field:
        columns |= {f"m{a}": c for a, c in zip(AXES, trial["imu_mag"].T, strict=True)}
    save(tmp_path / "imu.csv", columns)
    ran = swimid("track", "imu", tmp_path / "imu.csv", "-o", tmp_path / "run.csv", "--json")
    assert ran.status == 0
    found = table(tmp_path / "run.csv")
    seen = np.isfinite(trial["opt_pos"]).all(axis=1)
    place = np.column_stack([np.interp(time, time[seen], c) for c in trial["opt_pos"][seen].T])
    known = np.isfinite(trial["opt_quat"]).all(axis=1)
    optical = Rotation.from_quat(trial["opt_quat"][known][:, [1, 2, 3, 0]])
    told = Rotation.from_quat(found[["qx", "qy", "qz", "qw"]].to_numpy())
    heading = (optical * told[known].inv()).as_euler("ZYX")[:, 0]
    # which way x points at the start is not for the sensor to know
    turn = Rotation.from_euler("z", np.median(heading[:1000]))
    away = place - place[0] - turn.apply(found[[f"{a}_m" for a in AXES]].to_numpy())
    inside = np.abs(away) <= BAND * found[[f"{a}_sd_m" for a in AXES]].to_numpy()
    assert (inside.mean(axis=0) >= 0.9).all()
    sos = signal.butter(4, [0.3, 8.0], "band", fs=rate, output="sos")
    true = signal.sosfiltfilt(
        sos, np.gradient(np.gradient(place, 1 / rate, axis=0), 1 / rate, axis=0), axis=0
    )
    sensed = signal.sosfiltfilt(sos, turn.apply(found[[f"a{a}_world_m_s2" for a in AXES]].to_numpy()), axis=0)
    clear = trial["movement"].astype(bool) & (np.convolve(~seen, np.ones(201), "same") < 0.5)
    correlation = [np.corrcoef(sensed[clear, k], true[clear, k])[0, 1] for k in range(3)]
    drift = np.degrees(heading[-1] - np.median(heading[:1000]))
    yaw_band = np.degrees(BAND * found.yaw_sd_rad.iloc[-1])
    print(
        f"{name}: r {np.round(correlation, 4)}, inside "
        f"{inside.mean(axis=0).round(3)}, heading {drift:.2f} of ±{yaw_band:.1f} deg"
    )
    assert min(correlation) >= 0.995
    assert abs(drift) <= yaw_band
    assert (
        "heading at the end" in swimid("track", "imu", tmp_path / "imu.csv", "-o", tmp_path / "run.csv").out
    )
