"""``swimid compare`` on trials whose truth is known, and the strokes and derivatives under it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from swimid.fitting import fit_common
from swimid.logs import log as log_format
from swimid.logs.sampling import slope
from swimid.results import evidence
from swimid.results import parameters as parameters_format
from swimid.results.parameters import Estimate, ParameterFile
from swimid.simulation.compare_series import ComparisonFile
from tests.conftest import SAMPLES, Ran
from tests.generators import swimmer

Run = Callable[..., Ran]
POSE = ("x_m", "y_m", "yaw_rad")
NOISE = {"x_m": 0.001, "y_m": 0.001, "yaw_rad": 0.004, "u_m_s": 0.01, "yaw_rate_rad_s": math.radians(1.0)}


@cache
def _runs() -> tuple[swimmer.Run, ...]:
    found = []
    for frequency in (1.0, 1.6):
        for amplitude in (20.0, 30.0):
            drive = {"frequency_hz": frequency, "amplitude_deg": amplitude}
            columns = swimmer.simulate("tfish", None, drive, 6.0, rtol=1e-6)
            found.append(swimmer.Run(f"f{frequency:g}a{amplitude:g}", drive, columns))
    return tuple(found)


def _params(path: Path, **values: float) -> Path:
    estimates = {
        name: Estimate(value=values.get(name, value), unit="1", status="fixed")
        for name, value in swimmer.TFISH.items()
    }
    ParameterFile(model="multilink", robot="tfish", parameters=estimates).write(path)
    return path


@pytest.mark.kernels
def test_true_parameters_leave_residuals_of_the_size_of_the_noise(swimid: Run, tmp_path: Path) -> None:
    """With the true parameters the errors are those of the measurement, channel by channel."""
    columns = (*POSE, "u_m_s", "yaw_rate_rad_s")
    trials = swimmer.write_trials(tmp_path, "tfish", _runs(), NOISE, 5, columns=columns)
    out = tmp_path / "comparison.yaml"
    ran = swimid("compare", trials, "--params", _params(tmp_path / "p.yaml"), "-o", out)
    assert ran.status == 0, ran.err
    file = ComparisonFile.read(out)
    assert file.verdict == "good"
    count = file.channels["u_m_s"].samples
    for name, sd in NOISE.items():
        score = file.channels[name]
        assert score.source == "logged"
        # the rms of n samples is known to 1 / sqrt(2 n); three numbers a trial were fitted
        assert score.rmse == pytest.approx(sd, rel=5 / math.sqrt(2 * count)), name
    assert all(t.start == "estimated" for t in file.trials)
    assert set(file.trials[0].start_values) == {"start_x", "start_y", "start_yaw"}
    assert file.mean_speed_rmse_m_s is not None
    assert file.mean_speed_rmse_m_s < 0.002


@pytest.mark.kernels
def test_velocities_come_from_the_pose_where_they_are_not_logged(swimid: Run, tmp_path: Path) -> None:
    trials = swimmer.write_trials(tmp_path, "tfish", _runs(), NOISE, 5, columns=POSE)
    out = tmp_path / "comparison.yaml"
    ran = swimid("compare", trials, "--params", _params(tmp_path / "p.yaml"), "-o", out)
    assert ran.status == 0, ran.err
    file = ComparisonFile.read(out)
    rate = file.channels["yaw_rate_rad_s"]
    assert rate.source == "pose"
    assert rate.vaf is not None
    assert rate.vaf > 0.97
    trial = file.trials[0]
    # the paper's normalised peak error, from the smoothed series themselves
    true = _runs()[0].columns["yaw_rate_rad_s"]
    assert trial.channels["yaw_rate_rad_s"].peak_error is not None
    assert trial.channels["yaw_rate_rad_s"].peak_error < 0.15 * np.max(np.abs(true))


@pytest.mark.kernels
def test_a_wrong_coefficient_raises_the_error_of_the_channel_it_acts_on(swimid: Run, tmp_path: Path) -> None:
    """A third of the fin's drag: the simulation is slow in every trial, and the verdict says so."""
    trials = swimmer.write_trials(tmp_path, "tfish", _runs(), NOISE, 5, columns=POSE)
    wrong = _params(tmp_path / "p.yaml", c_d4=2.0)
    result = swimid("compare", trials, "--params", wrong, "--json").json["result"]
    assert result["verdict"] in ("caution", "bad")
    for trial in result["trials"]:
        assert trial["mean_speed"]["simulated"] < 0.8 * trial["mean_speed"]["measured"]
        assert trial["channels"]["u_m_s"]["bias"] > 0


@pytest.mark.slow
@pytest.mark.kernels
def test_a_start_state_of_the_file_is_used_and_a_new_one_estimated(swimid: Run, tmp_path: Path) -> None:
    trials = swimmer.write_trials(tmp_path, "tfish", _runs()[:2], NOISE, 5, columns=POSE)
    params = _params(tmp_path / "p.yaml")
    first = _runs()[0].id
    file = parameters_format.read(params)
    file.parameters[f"start_x[{first}]"] = Estimate(value=0.5, unit="m", status="estimated")
    file.write(params)
    result = swimid("compare", trials, "--params", params, "--json").json["result"]
    known, new = result["trials"]
    assert (known["start"], new["start"]) == ("file", "estimated")
    assert known["channels"]["x_m"]["bias"] == pytest.approx(-0.5, abs=0.01)
    assert abs(new["channels"]["x_m"]["bias"]) < 0.001
    plain = swimid("compare", trials, "--params", params, "--no-refit-start", "--json").json["result"]
    assert plain["trials"][1]["start"] == "neutral"


@pytest.mark.kernels
def test_joints_that_drive_the_run_are_not_compared(swimid: Run, tmp_path: Path) -> None:
    columns = (*POSE, "joint1_rad", "joint2_rad", "joint3_rad", "joint4_rad")
    trials = swimmer.write_trials(tmp_path, "tfish", _runs()[:1], {}, 5, columns=columns, with_drive=False)
    result = swimid("compare", trials, "--params", _params(tmp_path / "p.yaml"), "--json").json["result"]
    assert "joint4_rad" in result["channels"]
    assert "joint1_rad" not in result["channels"]
    # the beat is found in the joints
    assert result["trials"][0]["frequency_hz"] == pytest.approx(1.0, rel=0.02)
    assert result["channels"]["joint4_rad"]["vaf"] > 0.99


@pytest.mark.kernels
def test_the_evidence_has_errors_time_courses_speeds_and_paths(swimid: Run, tmp_path: Path) -> None:
    trials = swimmer.write_trials(tmp_path, "tfish", _runs(), NOISE, 5, columns=POSE)
    out, page = tmp_path / "comparison.yaml", tmp_path / "page.html"
    ran = swimid("compare", trials, "--params", _params(tmp_path / "p.yaml"), "-o", out)
    shown = evidence.read(evidence.sidecar(out))
    figures = {f.id: f for f in shown.figures}
    assert list(figures) == ["overlay", "speeds", "paths"]
    # a point of each trial, and the line where both speeds are equal
    assert [len(t.x) for t in figures["speeds"].panels[0].traces] == [4, 2]
    # surge and turning rate of the worst and of the best trial
    assert len({p.title for p in figures["overlay"].panels}) == 2
    assert len(figures["overlay"].panels) == 4
    file = ComparisonFile.read(out)
    pooled = shown.tables[0]
    assert [row[0].split()[0] for row in pooled.rows] == list(file.channels)
    assert pooled.columns == ["channel", "RMSE", "NRMSE", "VAF", "bias", "samples"]
    assert pooled.rows[0][5] == file.channels["x_m"].samples
    assert "robot tfish" in ran.out
    assert "start states" in ran.out
    assert {t.id for t in shown.tables} == {"channels", "speeds", "scores"}
    ran = swimid("report", out, "-o", page)
    assert ran.status == 0, ran.err
    assert "Errors of all trials together" in page.read_text()


@pytest.mark.slow
@pytest.mark.kernels
def test_rig_cruise_and_black_box_are_compared_too(swimid: Run, samples: Path, tmp_path: Path) -> None:
    rig, cruise = samples / "rig" / "trials.yaml", samples / "cruise" / "trials.yaml"
    drag, propulsion, arma = (tmp_path / f"{n}.yaml" for n in ("drag", "propulsion", "arma"))
    swimid("fit-drag", rig, "-o", drag)
    swimid("fit-propulsion", cruise, "--drag", drag, "-o", propulsion)
    result = swimid("compare", rig, "--params", drag, "--json").json["result"]
    # an encoder step of 7.85 mm is not an error: its clicks are
    assert result["channels"]["x_m"]["rmse"] < 0.003
    result = swimid("compare", cruise, "--params", propulsion, "--json").json["result"]
    fitted = parameters_format.read(propulsion).fit
    assert fitted is not None
    assert result["channels"]["mean_speed_m_s"]["vaf"] > 0.99
    marching = samples / "longfin" / "longfin_marching.csv"
    words = ("--input", "cmd1_rad", "--output", "u_m_s", "--na", "4", "--nb", "3")
    swimid("rwls", marching, *words, "-o", arma)
    trials = tmp_path / "arma_trials.yaml"
    trials.write_text(
        "format: swimid-trials/1\nexperiment: arma\nrobot: long-fin\ntrials:\n"
        f"  - {{id: a, log: {marching}}}\n  - {{id: b, log: {samples}/longfin/longfin_validation.csv}}\n"
    )
    free = swimid("compare", trials, "--params", arma, "--json").json["result"]
    fit = parameters_format.read(arma).fit
    assert fit is not None
    assert free["trials"][0]["channels"]["u_m_s"]["rmse"] == pytest.approx(
        fit.channels["u_m_s"]["free_run"]["rmse"], rel=0.05
    )
    # about its own level another record is described about as well
    assert free["trials"][1]["channels"]["u_m_s"]["vaf"] > 0.9


def test_friction_of_one_trial_is_not_refitted_as_a_start_state(
    swimid: Run, samples: Path, tmp_path: Path
) -> None:
    """A drop the fit has not seen starts where it starts; its pulley's friction is the common one."""
    trials = (samples / "rig" / "trials.yaml").read_text().replace("log: w", f"log: {samples}/rig/w")
    fewer = "".join(line for line in trials.splitlines(keepends=True) if "w40" not in line)
    (tmp_path / "trials.yaml").write_text(trials)
    (tmp_path / "fewer.yaml").write_text(fewer)
    drag = tmp_path / "drag.yaml"
    swimid("fit-drag", tmp_path / "fewer.yaml", "--free", "friction_deviation", "-o", drag)
    assert "friction_deviation[w35]" in parameters_format.read(drag).parameters
    result = swimid("compare", tmp_path / "trials.yaml", "--params", drag, "--json").json["result"]
    unseen = result["trials"][-1]
    assert (unseen["id"], unseen["start"], unseen["start_values"]) == ("w40", "neutral", {})
    assert unseen["channels"]["x_m"]["vaf"] > 0.99


@pytest.mark.parametrize(
    "robot, columns, text",
    [
        ("tfihs", POSE, "did you mean 'tfish'"),
        ("dolphin", ("x_m", "z_m", "pitch_rad"), "parameters of the robot 'tfish'"),
        ("tfish", ("x_m",), ""),
        ("tfish", (), "holds none of the robot's channels"),
    ],
)
def test_nothing_to_compare_is_reported_once(
    swimid: Run, tmp_path: Path, robot: str, columns: tuple[str, ...], text: str
) -> None:
    time = np.arange(100) / 50.0
    made = dict.fromkeys(columns, 0.1 * time) or {"battery_V": np.full(100, 7.4)}
    log_format.write(tmp_path / "a.csv", {"t_s": time, **made})
    (tmp_path / "trials.yaml").write_text(
        f"format: swimid-trials/1\nexperiment: free-swim\nrobot: {robot}\ntrials:\n"
        "  - {log: a.csv, drive: {frequency_hz: 1, amplitude_deg: 20}}\n"
    )
    ran = swimid("compare", tmp_path / "trials.yaml", "--params", _params(tmp_path / "p.yaml"))
    assert ran.status == (3 if text else 0), ran.err
    assert text in ran.err
    assert "Traceback" not in ran.err


def test_another_models_parameters_are_refused(swimid: Run, samples: Path, tmp_path: Path) -> None:
    ran = swimid("compare", samples / "rig" / "trials.yaml", "--params", _params(tmp_path / "p.yaml"))
    assert ran.status == 3
    assert "describe: free-swim" in ran.err


def test_an_unknown_channel_is_named(swimid: Run, tmp_path: Path) -> None:
    trials = swimmer.write_trials(tmp_path, "tfish", _runs()[:1], {}, 5, columns=POSE)
    params = _params(tmp_path / "p.yaml")
    ran = swimid("compare", trials, "--params", params, "--channels", "u_ms")
    assert ran.status == 2
    assert "did you mean 'u_m_s'" in ran.err


# ------------------------------------------------------------ what lies under it


def test_the_derivative_passes_the_beat_with_the_documented_gain() -> None:
    """The gain the docstring states, on uneven times."""
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.004, 0.012, 2000))
    frequency, half = 1.3, 0.2 / 1.3
    found = slope(time, np.sin(2 * np.pi * frequency * time), half)
    true = 2 * np.pi * frequency * np.cos(2 * np.pi * frequency * time)
    there = np.isfinite(found)
    gain = float(found[there] @ true[there] / (true[there] @ true[there]))
    assert gain == pytest.approx(1 - (2 * np.pi * frequency * half) ** 4 / 504, abs=1e-3)
    assert fit_common.compute_score(true[there], gain * true[there]).nrmse < 0.01
    assert not there[time < time[0] + 0.9 * half].any()


def test_a_derivative_does_not_bridge_a_gap() -> None:
    time = np.arange(0.0, 4.0, 0.02)
    values = np.where((time > 1.5) & (time < 2.5), np.nan, time**2)
    found = slope(time, values, 0.15)
    assert np.isnan(found[(time > 1.7) & (time < 2.3)]).all()
    there = np.isfinite(found)
    assert np.allclose(found[there], 2 * time[there], atol=1e-9)


@pytest.mark.slow
def test_file_and_evidence_state_one_verdict(swimid: Run, tmp_path: Path) -> None:
    """Displacements in millimetres: the warning about values that no swimmer reaches lowers both."""
    for path in (SAMPLES / "rig").iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert swimid("fit-drag", tmp_path / "trials.yaml", "-o", tmp_path / "drag.yaml").status == 0
    for path in tmp_path.glob("w*.csv"):
        log = pd.read_csv(path, comment="#")
        log["x_m"] *= 1000.0
        log.to_csv(path, index=False)
    out = tmp_path / "comparison.yaml"
    swimid("compare", tmp_path / "trials.yaml", "--params", tmp_path / "drag.yaml", "-o", out)
    said = json.loads((tmp_path / "comparison.evidence.json").read_text())
    assert f"verdict: {said['verdict']['level']}\n" in out.read_text()
    assert "no swimmer reaches" in said["verdict"]["text"]
