"""``swimid diagnose --next``: the trial that separates rival causes, written as a command file."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.stats import chi2

import swimid as package
from swimid.diagnosis.gap_file import GapFile
from swimid.logs import log as log_format
from tests.conftest import SAMPLES, Ran, command

Run = Callable[..., Ran]
Array = np.ndarray

#: Pulling masses of the noisy drops, g, their noise, m, and their sampling interval, s.
DROPS, NOISE, STEP = (20, 30, 40), 0.01, 0.1
#: Mass, pulley, area, density and gravity of the boxfish, in SI units.
MASS, PULLEY, AREA, DENSITY, GRAVITY = 1.196, 0.020, 0.00698, 997.0, 9.80
#: Value and standard error of drag coefficient and added mass in the parameter file of the drops.
KNOWN = ((0.93, 0.03), (0.7, 0.1))
PARAMETERS = """format: swimid-parameters/1
model: falling-weight
robot: boxfish
parameters:
  drag_coefficient: {value: 0.93, stderr: 0.03, unit: '1', bounds: [0.0, 5.0], status: estimated}
  added_mass: {value: 0.7, stderr: 0.1, unit: kg, bounds: [0.0, null], status: estimated}
  pulley_friction: {value: 0.0, stderr: null, unit: N, bounds: [0.0, null], status: fixed}
"""


def drop(theta: Array, mass_kg: float, time_s: Array, law: str) -> Array:
    """Displacement of a drop with pulley friction, or with a drag coefficient that falls with speed."""
    drag, added, size = theta
    inertia = MASS + PULLEY + mass_kg + added
    friction, power = (size, 0.0) if law == "pulley-friction" else (0.0, size)

    def rate(_: float, state: Array) -> list[float]:
        speed = max(state[1], 1e-9)
        resisted = 0.5 * DENSITY * AREA * drag * (speed / 0.2) ** -power * speed**2
        return [state[1], (mass_kg * GRAVITY - friction - resisted) / inertia]

    run = solve_ivp(rate, (0.0, time_s[-1] + 1e-9), [0.0, 0.0], t_eval=time_s, rtol=1e-8, atol=1e-10)
    return run.y[0]


@pytest.fixture(scope="module")
def drops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drops of the sample, seen by a noisy camera, and the parameters of a fit without friction."""
    folder, rng = tmp_path_factory.mktemp("drops"), np.random.default_rng(1)
    lines = ["format: swimid-trials/1", "experiment: falling-weight", "robot: boxfish", "trials:"]
    for grams in DROPS:
        log = log_format.read(SAMPLES / "rig" / f"w{grams}.csv")
        time = np.arange(0.0, log.time_s[-1], STEP)
        x = np.interp(time, log.time_s, log["x_m"]) + rng.normal(0.0, NOISE, len(time))
        pd.DataFrame({"t_s": time, "x_m": x}).to_csv(folder / f"w{grams}.csv", index=False)
        lines.append(f"  - {{id: w{grams}, log: w{grams}.csv, pulling_mass_kg: {grams / 1000}}}")
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
    (folder / "params.yaml").write_text(PARAMETERS)
    return folder


def diagnosed(folder: Path, name: str, *options: str | Path) -> tuple[GapFile, Ran]:
    """The gap file of a folder, diagnosed with a command file as further output."""
    out = folder / f"{name}.yaml"
    words = ["diagnose", folder / "trials.yaml", "--params", folder / "params.yaml", "-o", out]
    ran = command(*words, "--next", folder / f"{name}.csv", *options)
    assert ran.status == 0, ran.err
    return GapFile.read(out), ran


@pytest.fixture(scope="module")
def rig(drops: Path) -> tuple[Path, GapFile]:
    """The drops with two rival causes, and their gap file."""
    return drops, diagnosed(drops, "next", "--effects", "pulley-friction,drag-reynolds")[0]


def whitened(rows: Array) -> Array:
    """Samples or derivatives of one drop in independent units of the noise."""
    return rows / NOISE


def fitted(folder: Path, law: str) -> tuple[Array, Array]:
    """Estimate of a rival and its precision, from the noisy drops and the parameter file."""
    logs = {grams: log_format.read(folder / f"w{grams}.csv") for grams in DROPS}

    def residuals(theta: Array) -> Array:
        parts = [whitened(log["x_m"] - drop(theta, g / 1000, log.time_s, law)) for g, log in logs.items()]
        known = [(value - mean) / error for value, (mean, error) in zip(theta, KNOWN, strict=False)]
        return np.concatenate([*parts, known])

    start, scale = [0.7, 0.7, 0.02], [0.1, 0.1, 0.02]
    found = least_squares(residuals, start, x_scale=scale, diff_step=1e-4)
    return found.x, found.jac.T @ found.jac


def left_after_refit(apart: Array, rows: Array, precision: Array) -> float:
    """Root of the squared difference that a refit of one rival leaves."""
    taken = np.linalg.solve(rows.T @ rows + precision, rows.T @ apart)
    return math.sqrt(float(apart @ apart - (rows.T @ apart) @ taken))


@pytest.mark.slow
def test_the_rivals_differ_on_the_proposed_drop_by_the_stated_difference(rig: tuple[Path, GapFile]) -> None:
    folder, file = rig
    log = log_format.read(folder / "next.csv")
    best = file.advice[0]
    assert log.metadata["made_by"] == "swimid diagnose"
    assert log.metadata["separates"] == best.separates
    assert sorted(best.separates) == ["drag-reynolds", "pulley-friction"]
    assert log.metadata["difference"] == pytest.approx(best.difference, rel=0.01)
    mass, sampled = log.metadata["trial"]["pulling_mass_kg"], log.time_s
    assert np.unique(log["force_N"]) == pytest.approx([mass * GRAVITY])
    models = {}
    for law in best.separates:
        theta, precision = fitted(folder, law)
        moves = np.diag([1e-3, 1e-3, 1e-4])
        seen = drop(theta, mass, sampled, law)
        rows = [(drop(theta + move, mass, sampled, law) - seen) / move.sum() for move in moves]
        models[law] = whitened(seen), whitened(np.array(rows).T), precision
    (one, *first), (other, *second) = models.values()
    expected = min(left_after_refit(one - other, *first), left_after_refit(one - other, *second))
    assert best.difference == pytest.approx(expected, rel=0.25)


def test_only_differences_beyond_noise_are_proposed(rig: tuple[Path, GapFile]) -> None:
    """Drag, added mass and the effect are refitted: three degrees of freedom."""
    _, file = rig
    assert file.advice
    for advice in file.advice:
        assert advice.noise == pytest.approx(math.sqrt(chi2.ppf(0.95, 3)), rel=1e-6)
        assert advice.difference > advice.noise
    differences = [advice.difference for advice in file.advice]
    assert differences == sorted(differences, reverse=True)


def test_a_proposed_drop_stays_within_what_the_trials_did(rig: tuple[Path, GapFile]) -> None:
    folder, _ = rig
    log = log_format.read(folder / "next.csv")
    mass = log.metadata["trial"]["pulling_mass_kg"]
    assert 0.6 * min(DROPS) / 1000 <= mass <= 1.4 * max(DROPS) / 1000
    longest = max(np.ptp(log_format.read(folder / f"w{g}.csv")["x_m"]) for g in DROPS)
    for law in ("pulley-friction", "drag-reynolds"):
        assert drop(fitted(folder, law)[0], mass, log.time_s, law)[-1] <= 1.02 * longest


def test_the_entry_of_the_command_file_is_an_entry_of_a_trials_file(
    rig: tuple[Path, GapFile], tmp_path: Path
) -> None:
    folder, _ = rig
    log = log_format.read(folder / "next.csv")
    entry = log.metadata["trial"]
    x = drop(fitted(folder, "pulley-friction")[0], entry["pulling_mass_kg"], log.time_s, "pulley-friction")
    log_format.write(tmp_path / entry["log"], {**log.columns, "x_m": x}, log.metadata)
    trials = yaml.safe_load((folder / "trials.yaml").read_text())
    trials["trials"] = [entry]
    (tmp_path / "trials.yaml").write_text(yaml.safe_dump(trials))
    ran = command("compare", tmp_path / "trials.yaml", "--params", folder / "params.yaml")
    assert ran.status == 0, ran.err


@pytest.mark.slow
def test_a_shorter_tank_shortens_the_drop(drops: Path) -> None:
    options = ("--effects", "pulley-friction,drag-reynolds", "--tank-length-m", "0.8")
    file, _ = diagnosed(drops, "short", *options)
    assert file.advice[0].difference > 0
    log = log_format.read(drops / "short.csv")
    for law in file.advice[0].separates:
        mass = log.metadata["trial"]["pulling_mass_kg"]
        assert drop(fitted(drops, law)[0], mass, log.time_s, law)[-1] <= 0.82


@pytest.mark.slow
def test_a_tank_that_is_too_short_is_said_and_no_file_is_written(drops: Path) -> None:
    options = ("--effects", "pulley-friction,drag-reynolds", "--tank-length-m", "0.001")
    file, ran = diagnosed(drops, "tiny", *options)
    assert not (drops / "tiny.csv").exists()
    assert "SWM075" in ran.err
    assert "a path of at most 0.001 m" in " ".join(ran.err.split())
    assert [advice.difference for advice in file.advice] == [None]
    assert file.advice[0].text.startswith("none: no trial")


def test_a_command_file_of_another_program_is_kept(drops: Path) -> None:
    (drops / "mine.csv").write_text("t_s,force_N\n0,1\n1,1\n")
    words = [
        "diagnose",
        drops / "trials.yaml",
        "--params",
        drops / "params.yaml",
        "--next",
        drops / "mine.csv",
    ]
    assert command(*words).status == 2
    assert (drops / "mine.csv").read_text().startswith("t_s,force_N")


def test_detection_power_has_no_next_trial(drops: Path, swimid: Run) -> None:
    ran = swimid("diagnose", drops / "trials.yaml", "--power", "--next", drops / "none.csv")
    assert ran.status == 2
    assert "--next" in ran.err


@pytest.mark.slow
def test_no_trial_is_proposed_for_exact_twins(tmp_path: Path) -> None:
    """Viscous friction of the pulley and linear drag are one force."""
    lines = ["format: swimid-trials/1", "experiment: falling-weight", "robot: boxfish", "trials:"]
    rng = np.random.default_rng(2)
    for grams in DROPS:
        time = np.arange(0.0, 6.0, STEP)

        def rate(_: float, state: Array, pull: float = grams / 1000) -> list[float]:
            resisted = 0.5 * DENSITY * AREA * 0.7 * state[1] ** 2 + 0.4 * state[1]
            return [state[1], (pull * GRAVITY - resisted) / (MASS + PULLEY + pull + 0.7)]

        x = solve_ivp(rate, (0.0, 6.0), [0.0, 0.0], t_eval=time, rtol=1e-8).y[0]
        log_format.write(
            tmp_path / f"w{grams}.csv", {"t_s": time, "x_m": x + rng.normal(0.0, 0.001, len(time))}
        )
        lines.append(f"  - {{id: w{grams}, log: w{grams}.csv, pulling_mass_kg: {grams / 1000}}}")
    (tmp_path / "trials.yaml").write_text("\n".join(lines) + "\n")
    (tmp_path / "params.yaml").write_text(PARAMETERS.replace("0.93, stderr: 0.03", "0.7, stderr: 0.01"))
    file, ran = diagnosed(tmp_path, "next", "--effects", "linear-drag,pulley-viscous")
    assert {file.causes[0].effect, *file.causes[0].equivalent} == {"linear-drag", "pulley-viscous"}
    assert not (tmp_path / "next.csv").exists()
    assert file.verdict == "explained"
    assert file.advice == []
    assert "leaves no rival causes" in " ".join(ran.err.split())


@pytest.mark.slow
def test_a_rival_that_the_trials_exclude_needs_no_trial(tmp_path: Path) -> None:
    trials, params = SAMPLES / "rig" / "trials.yaml", tmp_path / "ideal.yaml"
    assert command("fit-drag", trials, "--fix", "pulley_friction=0", "-o", params).status == 0
    words = ["diagnose", trials, "--params", params, "--effects", "pulley-friction,linear-drag"]
    ran = command(*words, "-o", tmp_path / "gap.yaml", "--next", tmp_path / "next.csv")
    assert ran.status == 0, ran.err
    file = GapFile.read(tmp_path / "gap.yaml")
    assert [cause.effect for cause in file.causes] == ["pulley-friction"]
    assert file.advice == []
    assert not (tmp_path / "next.csv").exists()
    assert "leaves no rival causes" in " ".join(ran.err.split())


@pytest.mark.slow
def test_python_gives_the_proposed_trial_without_a_file(drops: Path) -> None:
    gap = package.diagnose(
        drops / "trials.yaml", params=drops / "params.yaml", effects=["pulley-friction", "drag-reynolds"]
    )
    assert gap.next is not None
    assert list(gap.next.columns) == ["t_s", "force_N"]
    assert gap.next.metadata["run"] == gap.file.advice[0].text


# ---------------------------------------------------------------- a robot with links

#: Noise that is added to the sample's track, m and rad.
TRACK_NOISE = {"x_m": 0.012, "y_m": 0.012, "yaw_rad": 0.08}
RIVALS = ("servo-backlash", "rate-limit")
#: Largest angle and rate of each joint in the limited robot file, degrees and degrees per second.
MAX_ANGLE, MAX_RATE = 7.0, 45.0


def swum(folder: Path, robot: str = "tfish") -> Path:
    """Two equal trials of the sample with more noise, which do not tell backlash from a limit of the rate."""
    rng = np.random.default_rng(3)
    lines = ["format: swimid-trials/1", "experiment: free-swim", f"robot: {robot}", "trials:"]
    for name in ("run01", "run02"):
        log = log_format.read(SAMPLES / "gap" / f"{name}.csv")
        columns = {c: v + rng.normal(0.0, TRACK_NOISE.get(c, 0.0), len(log)) for c, v in log.columns.items()}
        log_format.write(folder / f"{name}.csv", columns)
        lines.append(f"  - {{id: {name}, log: {name}.csv, drive: {{frequency_hz: 1, amplitude_deg: 25}}}}")
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
    (folder / "params.yaml").write_text((SAMPLES / "gap" / "params.yaml").read_text())
    return folder


def extent(x: Array, y: Array) -> float:
    """Largest distance between two points of a path."""
    x, y = np.asarray(x), np.asarray(y)
    return float(np.max(np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y))))


def actuated(log: log_format.Log, effect: str, size: float) -> log_format.Log:
    """The commands of a log as joints follow them with play, or with a limited rate."""
    columns = {"t_s": log.time_s}
    for name, angles in log.signals.items():
        found = angles.copy()
        for i in range(1, len(found)):
            low, high = angles[i] - 0.5 * size, angles[i] + 0.5 * size
            if effect == "rate-limit":
                step = size * (log.time_s[i] - log.time_s[i - 1])
                low = high = float(np.clip(angles[i], found[i - 1] - step, found[i - 1] + step))
            found[i] = float(np.clip(found[i - 1], low, high))
        columns[name] = found
    return log_format.Log(log.path, {}, columns)


@pytest.fixture(scope="module")
def fish(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, GapFile]:
    """The swimming trials with two rival causes, and their gap file."""
    folder = swum(tmp_path_factory.mktemp("fish"))
    return folder, diagnosed(folder, "next", "--effects", ",".join(RIVALS))[0]


@pytest.mark.slow
def test_a_command_file_has_the_joint_commands_and_its_entry(fish: tuple[Path, GapFile]) -> None:
    folder, file = fish
    log = log_format.read(folder / "next.csv")
    assert list(log.columns) == ["t_s", "cmd1_rad", "cmd2_rad", "cmd3_rad"]
    assert log.metadata["separates"] == file.advice[0].separates
    assert set(file.advice[0].separates) == set(RIVALS)
    assert log.metadata["difference"] > log.metadata["noise"] > log.metadata["now"]
    assert file.advice[0].text in ran_text(folder)
    # the whole tail bends by three joints of a third each
    assert np.degrees(3 * np.max(np.abs(log["cmd1_rad"]))) <= 1.4 * 25 + 0.1
    drive = log.metadata["trial"].get("drive")
    if drive:
        assert 0.6 <= drive["frequency_hz"] <= 1.4
        beat = np.sin(2 * np.pi * drive["frequency_hz"] * log.time_s) * np.radians(drive["amplitude_deg"]) / 3
        later = log.time_s > drive["ramp_s"]
        turn = np.radians(drive["bias_deg"]) / 3
        assert log["cmd2_rad"][later] == pytest.approx((beat + turn)[later], abs=1e-6)


def ran_text(folder: Path) -> str:
    """The text of the report of a diagnosis, with single spaces."""
    return " ".join(command("report", folder / "next.yaml", "--format", "md").out.split())


@pytest.mark.slow
def test_the_rivals_swim_the_proposed_trial_differently(fish: tuple[Path, GapFile]) -> None:
    """The refit of the coefficients takes up a part of the difference, but adds none."""
    folder, file = fish
    log = log_format.read(folder / "next.csv")
    paths = []
    for effect in RIVALS:
        alone = package.diagnose(folder / "trials.yaml", params=folder / "params.yaml", effects=[effect])
        cause = alone.file.causes[0]
        size = next(iter(cause.parameters.values())).value
        own = {a.coefficient: a.with_effect.value for a in cause.absorbed}
        log_format.write(folder / "moved.csv", actuated(log, effect, size).columns)
        run = package.simulate(
            params=folder / "params.yaml", chosen=own, input=folder / "moved.csv", dt=0.0025
        )
        paths.append(run.frame)
        assert extent(run.frame["x_m"], run.frame["y_m"]) < 0.3
    step = round(0.04 / float(np.diff(log.time_s)[0]))
    apart = [(paths[0][c] - paths[1][c]).to_numpy()[::step] / sd for c, sd in TRACK_NOISE.items()]
    whole = math.sqrt(sum(float(part @ part) for part in apart))
    assert file.advice[0].noise < file.advice[0].difference <= 1.4 * whole


@pytest.mark.slow
def test_limits_of_the_robot_the_tank_and_the_options_are_kept(tmp_path: Path) -> None:
    text = (Path(package.__file__).parent / "robots" / "tfish.yaml").read_text()
    limits = f"gain: 0.3333333333333333, max_angle_deg: {MAX_ANGLE}, max_rate_deg_s: {MAX_RATE}"
    (tmp_path / "limited.yaml").write_text(text.replace("gain: 0.3333333333333333", limits))
    folder = swum(tmp_path, "limited.yaml")
    options = ("--tank-length-m", "0.15", "--max-frequency-hz", "1.2", "--max-amplitude-deg", "20")
    file, _ = diagnosed(folder, "next", "--effects", ",".join(RIVALS), *options)
    log = log_format.read(folder / "next.csv")
    for name, angles in log.signals.items():
        assert np.degrees(np.max(np.abs(angles))) <= min(MAX_ANGLE, 20 / 3) + 1e-6, name
        assert np.degrees(np.max(np.abs(np.diff(angles) / np.diff(log.time_s)))) <= MAX_RATE + 1e-6, name
    rival = package.simulate(params=folder / "repaired.yaml", input=folder / "next.csv")
    assert extent(rival.frame["x_m"], rival.frame["y_m"]) <= 1.1 * 0.15
    run = package.simulate(params=folder / "params.yaml", input=folder / "next.csv")
    assert all(advice.difference != 0.0 for advice in file.advice)
    # without a drive, the commands of the log move the robot
    entry = {key: value for key, value in log.metadata["trial"].items() if key != "drive"}
    columns = {**log.columns, **{c: run.frame[c].to_numpy() for c in TRACK_NOISE}}
    log_format.write(folder / entry["log"], columns, log.metadata)
    trials = yaml.safe_load((folder / "trials.yaml").read_text())
    trials["trials"] = [entry]
    (folder / "swum.yaml").write_text(yaml.safe_dump(trials))
    ran = command("compare", folder / "swum.yaml", "--params", folder / "params.yaml", "--json")
    assert ran.status == 0, ran.err
    assert ran.json["result"]["channels"]["x_m"]["rmse"] < 0.001
