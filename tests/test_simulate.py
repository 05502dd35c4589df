"""``swimid simulate``: every model, against other code and closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import swimid as package
from swimid.logs import log as log_format
from swimid.results import parameters as parameters_format
from swimid.results.parameters import Correlation, Estimate, Fit, ParameterFile
from tests.conftest import Ran
from tests.generators import swimmer

Run = Callable[..., Ran]
pytestmark = pytest.mark.kernels

#: A robot with a light passive tail fin.
LIGHT_FIN = """
format: swimid-robot/1
name: tuna
sources: ["sizes guessed"]
fluid: {density_kg_m3: 1000}
multilink:
  plane: horizontal
  coefficients:
    c_d: {value: 1.2, bounds: [0, 5], meaning: drag across a link, source: flat plate}
    k_t: {value: 0.1, unit: N m/rad, bounds: [0.001, 10], meaning: stiffness of the tail, source: guess}
  links:
    - {name: body, length_m: 0.20, mass_kg: 0.60, com_m: 0.09, inertia_kg_m2: 2.0e-3, inertia_about: com}
    - {name: peduncle, length_m: 0.06, mass_kg: 0.08, com_m: 0.03, inertia_kg_m2: 3.0e-5, inertia_about: com}
    - {name: fin, length_m: 0.05, mass_kg: 0.02, com_m: 0.02, inertia_kg_m2: 5.0e-6, inertia_about: com}
  joints:
    - {name: hip, parent: body, child: peduncle, driven: {gain: 1.0}}
    - {name: root, parent: peduncle, child: fin, passive: {stiffness_N_m_rad: k_t, damping_N_m_s_rad: 0.001}}
  elements:
    - {kind: added-mass, link: body, sway_kg: 0.60, inertia_kg_m2: 2.0e-3}
    - {kind: added-mass, link: peduncle, sway_kg: 0.08, inertia_kg_m2: 3.0e-5}
    - {kind: drag, link: body, strips: 6, normal_area_m2: 0.012, normal_coefficient: c_d,
       axial_area_m2: 0.024, axial_coefficient: 0.01}
    - {kind: drag, link: fin, strips: 4, normal_area_m2: 0.004, normal_coefficient: c_d,
       axial_area_m2: 0.008, axial_coefficient: 0.01}
    - {kind: trailing-edge, link: fin, added_mass_kg_m: 5.0}
"""


def tfish_file(path: Path, **stderr: float) -> Path:
    """Table III as a parameter file, with standard errors where they are given."""
    estimates = {
        name: Estimate(value=value, stderr=stderr.get(name), unit="1", status="estimated")
        for name, value in swimmer.TFISH.items()
    }
    estimates["d_p"] = Estimate(value=0.03, unit="m", status="fixed")
    names = list(stderr)
    correlation = Correlation(names=names, matrix=np.eye(len(names)).tolist()) if len(names) > 1 else None
    ParameterFile(model="multilink", robot="tfish", parameters=estimates, correlation=correlation).write(path)
    return path


BEAT = ("--frequency-hz", "1", "--amplitude-deg", "20")


def test_a_tendon_fish_swims_as_in_an_independent_simulation(swimid: Run, tmp_path: Path) -> None:
    """The command of the manual; the log against the generator's own equations."""
    params, out = tfish_file(tmp_path / "tfish.yaml"), tmp_path / "sim.csv"
    ran = swimid("simulate", "--params", params, *BEAT, "--duration-s", "6", "-o", out)
    assert ran.status == 0, ran.err
    truth = swimmer.simulate("tfish", None, {"frequency_hz": 1.0, "amplitude_deg": 20.0}, 6.0)
    log = log_format.read(out)
    assert log.metadata["made_by"] == "swimid simulate"
    assert log.metadata["drive"]["frequency_hz"] == 1.0
    assert list(log.columns)[:7] == ["t_s", "x_m", "y_m", "yaw_rad", "u_m_s", "v_m_s", "yaw_rate_rad_s"]
    for name in ("x_m", "y_m", "yaw_rad", "u_m_s", "yaw_rate_rad_s", "joint1_rad", "joint4_rad"):
        # fixed steps of fourth order against an adaptive method at 1e-8
        assert np.max(np.abs(log[name] - truth[name])) < 1e-5 * np.ptp(truth[name]), name
    # a third of the command at each joint; no servo, so the joint is where it is told to be
    assert np.allclose(log["cmd1_rad"], log["joint1_rad"], atol=1e-9)
    assert np.max(np.abs(log["cmd1_rad"])) == pytest.approx(math.radians(20.0) / 3, rel=0.02)


#: Frequency (Hz) and amplitude (deg): mean surge (m/s) and maximum yaw rate (deg/s).
TFISH_FIGURES = {
    (0.7, 20): (0.031, 21.8), (1.0, 20): (0.098, 29.1), (1.0, 30): (0.241, 43.0), (1.4, 20): (0.238, 29.4),
    (1.4, 30): (0.384, 35.3), (1.8, 20): (0.326, 25.1), (1.8, 30): (0.461, 28.2), (2.2, 35): (0.543, 30.6),
}  # fmt: skip
#: Frequency (Hz) and K_s (N m/rad): mean surge (m/s).
DOLPHIN_FIGURES = {
    (2.90, 0.31): 0.693, (2.89, 0.62): 0.698, (2.88, 0.80): 0.673, (2.53, 0.31): 0.62, (2.88, 0.1): 0.487,
    (2.0, 3.0): 0.301, (5.0, 1.4): 1.226,
}  # fmt: skip
#: Largest errors of the yaw rate over the normalised ones, deg/s: the rows of Table IV without a defect.
PUBLISHED = {(1.0, 20): 0.816 / 0.029, (1.0, 30): 1.186 / 0.028, (1.4, 20): 0.390 / 0.014}


@pytest.mark.parametrize("beat", TFISH_FIGURES)
def test_a_tendon_fish_reaches_the_reference_figures(beat: tuple[float, float]) -> None:
    """Reference figures come from another implementation of the same reading."""
    log = package.simulate(robot="tfish", frequency_hz=beat[0], amplitude_deg=beat[1], duration_s=15.0).frame
    late = log.t_s > 15.0 - 3.0 / beat[0]
    speed, yaw = TFISH_FIGURES[beat]
    assert log.u_m_s[late].mean() == pytest.approx(speed, abs=0.001)
    peak = np.degrees(np.abs(log.yaw_rate_rad_s[late]).max())
    assert peak == pytest.approx(yaw, abs=0.15)
    assert peak == pytest.approx(PUBLISHED.get(beat, peak), rel=0.06)


@pytest.mark.parametrize("case", DOLPHIN_FIGURES)
def test_a_dolphin_reaches_the_reference_figures(case: tuple[float, float]) -> None:
    beat = {"frequency_hz": case[0], "amplitude_deg": 27.0, "duration_s": 10.0, "sample_rate_hz": 200.0}
    log = package.simulate(robot="dolphin", chosen={"K_s": case[1]}, **beat).frame
    late = log.t_s > 10.0 - 4.0 / case[0]
    assert log.u_m_s[late].mean() == pytest.approx(DOLPHIN_FIGURES[case], abs=0.002)
    if case == (2.53, 0.31):
        assert np.degrees(np.ptp(log.joint3_rad[late])) / 2 == pytest.approx(31.0, abs=0.5)
        assert np.degrees(np.ptp(log.pitch_rad[late])) / 2 == pytest.approx(6.7, abs=0.1)


def test_drag_in_strips_equals_that_of_an_independent_simulation(swimid: Run, tmp_path: Path) -> None:
    params = tfish_file(tmp_path / "tfish.yaml")
    out = tmp_path / "sim.csv"
    swimid(
        "simulate",
        "--params",
        params,
        *BEAT,
        "--duration-s",
        "6",
        "-o",
        out,
        "--reading",
        "drag_point=strips",
    )
    beat = {"frequency_hz": 1.0, "amplitude_deg": 20.0}
    truth = swimmer.simulate("tfish", None, beat, 6.0, drag_at="slices")
    log = log_format.read(out)
    assert log.metadata["readings"] == {"drag_point": "strips"}
    for name in ("x_m", "yaw_rad", "u_m_s", "joint4_rad"):
        # four Gauss points a link here, forty slices there
        assert np.max(np.abs(log[name] - truth[name])) < 0.02 * np.ptp(truth[name]), name


@pytest.mark.slow
def test_standard_errors_equal_the_scatter_of_random_draws(swimid: Run, tmp_path: Path) -> None:
    """The delta method against runs with parameters drawn from their errors."""
    errors = {"c_d4": 0.05, "c_f0": 0.0004}
    params = tfish_file(tmp_path / "tfish.yaml", **errors)
    args = ("simulate", "--params", params, *BEAT, "--duration-s", "8", "--json")
    quantity = swimid(*args).json["result"]["runs"][0]["quantities"]["mean_speed_m_s"]
    rng = np.random.default_rng(7)
    speeds = []
    for _ in range(60):
        drawn = [f"{n}={swimmer.TFISH[n] + e * rng.standard_normal()}" for n, e in errors.items()]
        words = [w for d in drawn for w in ("--set", d)]
        result = swimid(*args, *words).json["result"]["runs"][0]["quantities"]
        speeds.append(result["mean_speed_m_s"]["value"])
    # the spread of 60 draws is known to 9 %
    assert quantity["stderr"] == pytest.approx(np.std(speeds), rel=0.3)
    assert abs(quantity["value"] - np.mean(speeds)) < 4 * quantity["stderr"] / math.sqrt(60)


def test_a_robot_alone_has_no_uncertainty(swimid: Run) -> None:
    ran = swimid("simulate", "--robot", "dolphin", "--frequency-hz", "2.53", "--amplitude-deg", "27")
    assert ran.status == 0
    assert "No uncertainty known" in ran.out
    assert "strouhal" in ran.out


def test_turning_radius_is_speed_over_turning_rate(swimid: Run) -> None:
    args = ("simulate", "--robot", "tfish", "--frequency-hz", "1", "--amplitude-deg", "30", "--json")
    found = swimid(*args, "--bias-deg", "20", "--duration-s", "25").json["result"]["runs"][0]["quantities"]
    speed, rate = found["mean_speed_m_s"]["value"], found["mean_yaw_rate_rad_s"]["value"]
    assert found["turning_radius_m"]["value"] == pytest.approx(speed / abs(rate))
    # a positive bend turns the tail to starboard, and the fish, too
    assert rate < 0.0
    mirrored = swimid(*args, "--bias-deg", "-20", "--duration-s", "25").json["result"]["runs"][0][
        "quantities"
    ]
    # the beat begins to the same side, so the two turns are not mirror images of each other
    assert mirrored["mean_yaw_rate_rad_s"]["value"] == pytest.approx(-rate, rel=0.05)
    straight = swimid(*args).json["result"]["runs"][0]["quantities"]
    assert "turning_radius_m" not in straight


def test_a_coarse_step_is_halved_until_the_samples_hardly_change(swimid: Run) -> None:
    words = ("simulate", "--robot", "tfish", *BEAT, "--duration-s", "4", "--sample-rate-hz", "20", "--json")
    fine, coarse = swimid(*words).json, swimid(*words, "--dt", "0.05").json
    runs = [done["result"]["runs"][0] for done in (fine, coarse)]
    assert [max(run["step_check"].values()) <= 1.0 for run in runs] == [True, True]
    assert runs[0]["metadata"]["dt_s"] == 0.005 < runs[1]["metadata"]["dt_s"] < 0.05
    speeds = [run["quantities"]["mean_speed_m_s"]["value"] for run in runs]
    assert speeds[1] == pytest.approx(speeds[0], rel=2e-3)
    assert "SWM016" not in {w["code"] for w in coarse["warnings"]}


def test_a_light_fin_takes_a_smaller_step_than_given(swimid: Run, tmp_path: Path) -> None:
    """A light passive fin without added mass oscillates so fast that the default step diverges."""
    robot = tmp_path / "tuna.yaml"
    robot.write_text(LIGHT_FIN, encoding="utf-8")
    words = (
        "simulate",
        "--robot",
        robot,
        "--frequency-hz",
        "2",
        "--amplitude-deg",
        "20",
        "--duration-s",
        "5",
    )
    ran, fine = swimid(*words, "--json"), swimid(*words, "--dt", "0.0005", "--json")
    assert ran.status == 0, ran.err
    runs = [done.json["result"]["runs"][0] for done in (ran, fine)]
    assert runs[0]["metadata"]["dt_s"] < 0.005
    speeds = [run["quantities"]["mean_speed_m_s"]["value"] for run in runs]
    assert speeds == pytest.approx([0.5458, 0.5458], abs=1e-4)


def test_a_log_drives_the_joints(swimid: Run, tmp_path: Path) -> None:
    """Joint angles taken from a simulated log give the same run again."""
    first, again = tmp_path / "first.csv", tmp_path / "again.csv"
    swimid("simulate", "--robot", "tfish", *BEAT, "--duration-s", "6", "-o", first)
    ran = swimid("simulate", "--robot", "tfish", "--input", first, "-o", again)
    assert ran.status == 0, ran.err
    a, b = log_format.read(first), log_format.read(again)
    for name in ("x_m", "yaw_rad", "joint4_rad"):
        assert np.max(np.abs(a[name] - b[name])) < 0.01 * np.ptp(a[name]), name


@pytest.mark.slow
def test_recorded_trials_keep_their_drives_and_start_states(swimid: Run, tmp_path: Path) -> None:
    drive = {"frequency_hz": 1.2, "amplitude_deg": 25.0}
    columns = swimmer.simulate("tfish", None, drive, 5.0)
    columns["x_m"] = columns["x_m"] + 1.5
    runs = [swimmer.Run("a", drive, columns), swimmer.Run("b", {**drive, "bias_deg": 10}, columns)]
    trials = swimmer.write_trials(tmp_path, "tfish", runs, {}, 1, columns=("x_m", "y_m", "yaw_rad"))
    params = tfish_file(tmp_path / "tfish.yaml")
    ran = swimid("simulate", "--params", params, "--trials", trials, "-o", tmp_path / "sim")
    assert ran.status == 0, ran.err
    made = log_format.read(tmp_path / "sim" / "a.csv")
    assert made["x_m"][0] == pytest.approx(1.5)
    assert made.metadata["drive"]["amplitude_deg"] == 25.0
    assert log_format.read(tmp_path / "sim" / "b.csv").metadata["drive"]["bias_deg"] == 10.0
    ran = swimid(
        "simulate", "--params", params, "--trials", trials, "--trial", "b", "-o", tmp_path / "sim_b.csv"
    )
    assert ran.status == 0
    assert (tmp_path / "sim_b.csv").exists()


def test_a_falling_weight_reaches_its_terminal_speed(swimid: Run, samples: Path, tmp_path: Path) -> None:
    drag, out = tmp_path / "drag.yaml", tmp_path / "drop.csv"
    swimid("fit-drag", samples / "rig" / "trials.yaml", "-o", drag)
    ran = swimid(
        "simulate", "--params", drag, "--pulling-mass-kg", "0.02", "--duration-s", "60", "-o", out, "--json"
    )
    found = ran.json["result"]["runs"][0]["quantities"]
    values = parameters_format.read(drag)
    net = 0.02 * 9.8 - values.value("pulley_friction")
    top = math.sqrt(net / (0.5 * 997 * values.value("drag_coefficient") * 69.8e-4))
    # gravity and area of the built-in robot, to their printed digits
    assert found["terminal_speed_m_s"]["value"] == pytest.approx(top, rel=5e-3)
    assert found["last_speed_m_s"]["value"] == pytest.approx(found["terminal_speed_m_s"]["value"], rel=1e-6)
    log = log_format.read(out)
    assert np.allclose(np.gradient(log["x_m"], log.time_s)[1:-1], log["u_m_s"][1:-1], atol=2e-4)


def test_every_kind_of_parameter_file_simulates_its_trials(
    swimid: Run, samples: Path, tmp_path: Path
) -> None:
    drag, propulsion = tmp_path / "drag.yaml", tmp_path / "propulsion.yaml"
    swimid("fit-drag", samples / "rig" / "trials.yaml", "-o", drag)
    swimid("fit-propulsion", samples / "cruise" / "trials.yaml", "--drag", drag, "-o", propulsion)
    ran = swimid(
        "simulate", "--params", drag, "--trials", samples / "rig" / "trials.yaml", "-o", tmp_path / "rig"
    )
    assert ran.status == 0, ran.err
    recorded = log_format.read(samples / "rig" / "w20.csv")
    made = log_format.read(tmp_path / "rig" / "w20.csv")
    there = np.interp(made.time_s, recorded.time_s, recorded["x_m"])
    # half an encoder step either way
    assert np.max(np.abs(there - made["x_m"])) < 0.008
    cruise = samples / "cruise" / "trials.yaml"
    ran = swimid("simulate", "--params", propulsion, "--trials", cruise, "-o", tmp_path / "cruise")
    assert ran.status == 0, ran.err
    one = ("--frequency-hz", "3", "--amplitude-deg", "20", "--fin", "3825Rect", "--distance-m", "1.15")
    found = swimid("simulate", "--params", propulsion, *one, "--json").json["result"]["runs"][0]["quantities"]
    assert found["mean_speed_m_s"]["value"] < found["terminal_speed_m_s"]["value"]
    assert found["mean_speed_m_s"]["stderr"] > 0


def test_a_black_box_runs_without_measured_outputs(swimid: Run, samples: Path, tmp_path: Path) -> None:
    arma, log, out = (
        tmp_path / "arma.yaml",
        samples / "longfin" / "longfin_marching.csv",
        tmp_path / "free.csv",
    )
    swimid("rwls", log, "--input", "cmd1_rad", "--output", "u_m_s", "--na", "4", "--nb", "3", "-o", arma)
    ran = swimid("simulate", "--params", arma, "--input", log, "-o", out)
    assert ran.status == 0, ran.err
    file = parameters_format.read(arma)
    a, b = ([file.value(f"{k}{i}") for i in range(1, n + 1)] for k, n in (("a", 4), ("b", 3)))
    u = log_format.read(log)["cmd1_rad"] - file.settings["input_level"]
    y = list(log_format.read(log)["u_m_s"][:4] - file.settings["output_level"])
    for k in range(4, 400):
        y.append(sum(-a[i] * y[k - 1 - i] for i in range(4)) + sum(b[i] * u[k - 1 - i] for i in range(3)))
    made = log_format.read(out)["u_m_s"][:400] - file.settings["output_level"]
    assert np.allclose(made, y, atol=1e-9)


@pytest.mark.parametrize("ending", [".mp4", ".gif"])
def test_a_film_shows_the_robot_swim(swimid: Run, tmp_path: Path, ending: str) -> None:
    film = tmp_path / f"swim{ending}"
    args = ("simulate", "--robot", "tfish", "--frequency-hz", "2", "--amplitude-deg", "30")
    for _ in range(2):  # a second run may replace it
        ran = swimid(*args, "--duration-s", "2", "--animate", film)
        assert ran.status == 0, ran.err
    if ending == ".gif":
        from PIL import Image

        picture = Image.open(film)
        assert picture.n_frames == 51
        picture.seek(50)
        last = np.asarray(picture.convert("RGB")).astype(int)[:, :, ::-1]
    else:
        capture = cv2.VideoCapture(str(film))
        frames = []
        while (read := capture.read())[0]:
            frames.append(read[1])
        assert len(frames) == 51
        last = frames[-1].astype(int)
    water = np.median(last.reshape(-1, 3), axis=0)
    share = np.mean(np.abs(last - water).sum(axis=2) > 150)
    # a body a sixth as wide as long, in a picture about two lengths wide and one high
    assert 0.02 < share < 0.3


@pytest.mark.parametrize(
    "words, status, text",
    [
        ((), 2, "name a parameter file"),
        (("--robot", "tfihs", *BEAT), 3, "did you mean 'tfish'"),
        (("--robot", "boxfish", *BEAT), 3, "no 'multilink' or 'multibody' part"),
        (("--robot", "tfish"), 2, "the beat has no frequency_hz"),
        (("--robot", "tfish", "--frequency-hz", "1"), 2, "the beat has no amplitude_deg"),
        (("--robot", "tfish", "--frequency-hz", "150", "--amplitude-deg", "9"), 2, "cannot be integrated"),
        (("--robot", "tfish", *BEAT, "--set", "c_m=1"), 2, "did you mean 'c_ma'"),
        (("--robot", "tfish", *BEAT, "--reading", "areas=both"), 2, "no option 'both'"),
        (("--robot", "tfish", *BEAT, "--trial", "a"), 2, "--trial is given without --trials"),
        (
            ("--robot", "tfish", *BEAT, "--animate", "film.avi"),
            2,
            "is not a valid file name for an animation",
        ),
        (("--robot", "tfish", *BEAT, "-o", "sim.txt"), 2, "must be a folder, or end in"),
        (("--robot", "tfish", *BEAT, "-o", "nowhere/sim.csv"), 3, "does not exist"),
        (("--robot", "tfish", *BEAT, "--set", "c_ma=-1.5"), 3, "not positive definite"),
        (("--robot", "tfish", *BEAT, "--trials", "t.yaml"), 2, "cannot be combined with --trials"),
    ],
)
def test_impossible_simulations_are_refused_with_a_reason(
    swimid: Run, words: tuple[str, ...], status: int, text: str
) -> None:
    ran = swimid("simulate", *words)
    assert ran.status == status, ran.err
    assert text in ran.err
    assert "Traceback" not in ran.err


def test_a_simulation_that_diverges_reports_the_time(swimid: Run) -> None:
    ran = swimid("simulate", "--robot", "tfish", *BEAT, "--set", "c_d4=1e9")
    assert ran.status == 4
    assert "diverges at t = " in ran.err
    assert "--dt" in ran.err


def test_parameters_of_another_robot_are_refused(swimid: Run, tmp_path: Path) -> None:
    params = tfish_file(tmp_path / "tfish.yaml")
    ran = swimid("simulate", "--params", params, "--robot", "dolphin", *BEAT)
    assert ran.status == 3
    assert "another robot" in ran.err


def test_values_out_of_bounds_are_warned_of(swimid: Run) -> None:
    args = ("simulate", "--robot", "tfish", "--duration-s", "2", "--json")
    ran = swimid(*args, "--frequency-hz", "1", "--amplitude-deg", "20", "--set", "c_d4=7")
    assert "SWM053" in {w["code"] for w in ran.json["warnings"]}


def test_a_joint_that_folds_through_the_body_is_warned_of(swimid: Run) -> None:
    """500 degrees of tail bend leave every driven joint below 180, and whip the passive one round."""
    ran = swimid("simulate", "--robot", "tfish", "--frequency-hz", "1", "--amplitude-deg", "500", "--json")
    assert any("joint4 turns by" in w["text"] for w in ran.json["warnings"])
    ran = swimid("simulate", "--robot", "tfish", *BEAT, "--json")
    assert not any("turns by" in w["text"] for w in ran.json["warnings"])


def test_values_of_a_fit_that_did_not_converge_are_warned_of(swimid: Run, tmp_path: Path) -> None:
    path = tfish_file(tmp_path / "tfish.yaml", c_d0=0.1)
    file = parameters_format.read(path)
    file.parameters["c_d0"].status = "unidentifiable"
    file.fit = Fit(trials=["a"], converged=False)
    file.write(path)
    ran = swimid("simulate", "--params", path, *BEAT, "--duration-s", "2", "--json")
    said = [w["text"] for w in ran.json["warnings"] if w["code"] == "SWM062"]
    assert len(said) == 2
    assert "did not converge" in said[0]
    assert "c_d0" in said[1]
    ran = swimid("simulate", "--params", path, *BEAT, "--duration-s", "2", "--set", "c_d0=1.2", "--json")
    assert not any("c_d0" in w["text"] for w in ran.json["warnings"])


@pytest.mark.slow
def test_a_simulated_log_can_be_reported(swimid: Run, tmp_path: Path) -> None:
    out = tmp_path / "sim.csv"
    swimid("simulate", "--robot", "tfish", *BEAT, "--duration-s", "4", "-o", out)
    ran = swimid("report", out, "-o", tmp_path / "report.html")
    assert ran.status == 0, ran.err
    assert "swimid simulate" in (tmp_path / "report.html").read_text()
