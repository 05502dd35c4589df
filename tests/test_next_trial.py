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
from tests.conftest import SAMPLES, Ran
from tests.test_diagnose import command

Run = Callable[..., Ran]
Array = np.ndarray

#: Pulling masses of the noisy drops, g, their noise, m, and their sampling interval, s.
DROPS, NOISE, STEP = (20, 30, 40), 0.01, 0.1
#: Share of the noise variance that is correlated, and its correlation between successive samples, which a
#: diagnosis of few trials assumes.
COLOURED, POLE = 0.4, 0.8
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
    apart = np.abs(np.subtract.outer(np.arange(len(rows)), np.arange(len(rows))))
    covariance = NOISE**2 * (COLOURED * POLE**apart + (1.0 - COLOURED) * (apart == 0))
    return np.linalg.solve(np.linalg.cholesky(covariance), rows)


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


def test_a_shorter_tank_shortens_the_drop(drops: Path) -> None:
    options = ("--effects", "pulley-friction,drag-reynolds", "--tank-length-m", "0.8")
    file, _ = diagnosed(drops, "short", *options)
    assert file.advice[0].difference > 0
    log = log_format.read(drops / "short.csv")
    for law in file.advice[0].separates:
        mass = log.metadata["trial"]["pulling_mass_kg"]
        assert drop(fitted(drops, law)[0], mass, log.time_s, law)[-1] <= 0.82


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
    words = ["diagnose", drops / "trials.yaml", "--params", drops / "params.yaml", "--next", drops / "mine.csv"]
    assert command(*words).status == 2
    assert (drops / "mine.csv").read_text().startswith("t_s,force_N")


def test_detection_power_has_no_next_trial(drops: Path, swimid: Run) -> None:
    ran = swimid("diagnose", drops / "trials.yaml", "--power", "--next", drops / "none.csv")
    assert ran.status == 2
    assert "--next" in ran.err


def test_no_trial_is_proposed_for_exact_twins(drops: Path, tmp_path: Path) -> None:
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
    assert len(file.advice) == 1
    assert "none separates" in file.advice[0].text
    assert file.advice[0].separates == []
    assert file.advice[0].difference is None
    assert "none separates" in " ".join(ran.err.split())


def test_python_gives_the_proposed_trial_without_a_file(drops: Path) -> None:
    gap = package.diagnose(
        drops / "trials.yaml", params=drops / "params.yaml", effects=["pulley-friction", "drag-reynolds"]
    )
    assert gap.next is not None
    assert list(gap.next.columns) == ["t_s", "force_N"]
    assert gap.next.metadata["run"] == gap.file.advice[0].text
