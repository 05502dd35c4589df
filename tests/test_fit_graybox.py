"""``swimid fit-graybox`` on trials from an independent simulator."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error, uncertainty
from swimid.fitting.fit_common import load_experiment
from swimid.fitting.model import Parameter
from swimid.notices import Step
from swimid.results import evidence, parameters
from swimid.results.parameters import ParameterFile
from swimid.robots import file as robot_format
from swimid.swimmer.fit_graybox import fit_graybox
from tests.conftest import SAMPLES, Ran
from tests.generators import gap_trials, swimmer
from validation.blind import swim_actuation

Swimid = Callable[..., Ran]
Table = dict[str, np.ndarray]

RATES = {"u_m_s": 0.01, "yaw_rate_rad_s": float(np.radians(1.0))}
POSE = {"x_m": 0.002, "y_m": 0.002, "yaw_rad": float(np.radians(0.5))}
TRUTH = {**swimmer.TFISH, "c_ma": 1.0, "c_Ia": 1.45, "c_d0": 4.1, "c_d13": 0.5, "c_f0": 0.02}
#: Local error of the truth: noise is a thousand times as large.
FINE = 1e-6
FRICTIONS = ("c_f0", "c_f13", "c_f4")
#: One coefficient for all friction, all else as above.
SHARED = {**TRUTH, **dict.fromkeys(FRICTIONS, 0.02)}


def _drive(frequency: float, amplitude: float, bias: float = 0.0) -> dict[str, float]:
    return {"frequency_hz": frequency, "amplitude_deg": amplitude, "bias_deg": bias}


@cache
def _runs(shared: bool = False) -> tuple[swimmer.Run, ...]:
    """Write three short runs to fit and one held-out run."""
    truth = SHARED if shared else TRUTH
    found = []
    for name, drive in (
        ("slow", _drive(1.0, 30, 10)),
        ("fast", _drive(1.8, 20, -10)),
        ("wide", _drive(1.4, 30)),
        ("held", _drive(1.2, 25, 8)),
    ):
        columns = swimmer.simulate("tfish", truth, drive, 6.0, rtol=FINE)
        found.append(swimmer.Run(name, drive, columns, "validate" if name == "held" else "fit"))
    return tuple(found)


@cache
def _published(drag_at: str) -> tuple[swimmer.Run, ...]:
    """Write six runs of 20 s with the published coefficients."""
    drives = [(1.0, 20, 0), (1.0, 30, 10), (1.4, 20, 0), (1.4, 30, -15), (1.8, 20, 10), (2.0, 30, 0)]
    found = []
    for k, numbers in enumerate(drives):
        drive = _drive(*numbers)
        found.append(
            swimmer.Run(
                f"r{k}", drive, swimmer.simulate("tfish", None, drive, 20.0, rtol=FINE, drag_at=drag_at)
            )
        )
    return tuple(found)


def _write(
    folder: Path, runs: Sequence[swimmer.Run], noise: dict[str, float], seed: int = 1, **options: Any
) -> Path:
    return swimmer.write_trials(folder, "tfish", runs, noise, seed, **{"columns": list(noise), **options})


def _fit(swimid: Swimid, trials: Path, *options: str) -> ParameterFile:
    out = trials.parent / "fit.yaml"
    ran = swimid("fit-graybox", trials, "-o", out, *options)
    assert ran.status == 0, ran.err
    return parameters.read(out)


def _deviations(file: ParameterFile, truth: dict[str, float]) -> dict[str, float]:
    """Return the error of each estimated coefficient in standard errors."""
    return {
        name: (e.value - truth[name]) / e.stderr
        for name, e in file.parameters.items()
        if name in truth and e.status == "estimated" and e.stderr
    }


def _sums(file: ParameterFile, truth: dict[str, float]) -> dict[str, float]:
    """Return the error of each known sum of coefficients in standard errors."""
    found = {}
    for text, estimate in file.derived.items():
        total = 0.0
        for term in text.replace(" - ", " + -").split(" + "):
            *factor, name = term.split()
            total += (float(factor[0]) if factor else 1.0) * truth[name]
        assert estimate.stderr
        found[text] = (estimate.value - total) / estimate.stderr
    return found


def _log(path: Path) -> tuple[list[str], Table]:
    lines = path.read_text().splitlines()
    header = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    names = lines[header].split(",")
    values = np.array([[float(c) for c in line.split(",")] for line in lines[header + 1 :]])
    return names, dict(zip(names, values.T, strict=True))


def _rewrite(path: Path, change: Callable[[Table], Table]) -> None:
    """Change columns of a log; NaN becomes an empty cell."""
    _, table = _log(path)
    table = change(dict(table))
    rows = zip(*table.values(), strict=True)
    text = [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in rows]
    path.write_text("\n".join([",".join(table), *text]) + "\n")


class TestRecovery:
    @pytest.mark.slow
    def test_speed_and_yaw_rate(self, swimid: Swimid, tmp_path: Path) -> None:
        file = _fit(swimid, _write(tmp_path, _runs(), RATES))
        off = _deviations(file, TRUTH)
        assert {"c_ma", "c_Ia", "c_d0", "c_d13", "c_d4"} <= set(off)
        assert max(map(abs, off.values())) < 3, off
        assert not set(FRICTIONS) & set(off)
        assert file.fit is not None
        assert file.fit.converged
        for channel, sd in RATES.items():
            # 3 x 301 samples: the noise's size is known to 1 / sqrt(2 n)
            assert file.fit.noise[channel]["value_sd"] == pytest.approx(sd, rel=4 / np.sqrt(2 * 903))
            assert file.fit.validation["channels"][channel]["rmse"] == pytest.approx(sd, rel=0.2)

    def test_pose(self, swimid: Swimid, tmp_path: Path) -> None:
        file = _fit(swimid, _write(tmp_path, _runs(), POSE))
        off = _deviations(file, TRUTH)
        assert {"c_ma", "c_Ia", "c_d0", "c_d13", "c_d4"} <= set(off)
        assert max(map(abs, off.values())) < 3, off
        assert file.parameters["start_yaw[slow]"].status in ("estimated", "unidentifiable")

    def test_a_parameter_file_is_read_back_exactly(self, swimid: Swimid, tmp_path: Path) -> None:
        trials = _write(tmp_path, _runs(), RATES)
        out = tmp_path / "fit.yaml"
        ran = swimid("fit-graybox", trials, "-o", out, "--json")
        assert ran.status == 0, ran.err
        told = ran.json["result"]["parameters"]
        file = parameters.read(out)
        assert list(told) == list(file.parameters)
        for name, e in file.parameters.items():
            assert (told[name]["value"], told[name]["stderr"]) == (e.value, e.stderr)
        experiment = load_experiment(trials)
        values = np.array(
            [
                file.value(p.name) if p.name in file.parameters else p.start
                for p in experiment.model.parameters
            ]
        )
        errors = [
            t.measured["u_m_s"] - experiment.model.simulate(values, t)["u_m_s"]
            for t in experiment.trials
            if t.role == "fit"
        ]
        assert file.fit is not None
        assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) == file.fit.channels["u_m_s"]["rmse"]
        beside = evidence.read(evidence.sidecar(out))
        assert {"metrics", "readings"} <= {t.id for t in beside.tables}


class TestChoices:
    @pytest.mark.slow
    def test_one_friction(self, swimid: Swimid, tmp_path: Path) -> None:
        file = _fit(swimid, _write(tmp_path, _runs(shared=True), RATES), "--share", "c_f")
        first, *others = [file.parameters[name] for name in FRICTIONS]
        assert all(e == first for e in others)
        assert first.status == "estimated"
        assert first.stderr
        assert first.stderr < 0.2 * first.value
        assert file.settings["shared"] == {"c_f": list(FRICTIONS)}
        assert "c_f" not in file.parameters
        off = _deviations(file, SHARED)
        assert len(off) == 8
        assert max(map(abs, off.values())) < 3, off

    @pytest.mark.slow
    def test_bounds_and_fixed(self, swimid: Swimid, tmp_path: Path) -> None:
        trials = _write(tmp_path, _runs(shared=True), RATES)
        file = _fit(
            swimid, trials, "--share", "c_f", "--fix", "c_d13=0.5", "--bounds", "c_d4=0,5", "--free", "d_p"
        )
        assert file.parameters["c_d13"].value == 0.5
        assert file.parameters["c_d13"].status == "fixed"
        assert file.parameters["c_d4"].bounds == (0, 5)
        assert file.parameters["c_d4"].status == "at-bound"
        assert file.parameters["d_p"].status != "fixed"


class TestTrialsThatDisagree:
    @pytest.mark.slow
    @pytest.mark.parametrize(
        "noise", [RATES, pytest.param(POSE, marks=pytest.mark.slow)], ids=["rates", "pose"]
    )
    def test_standard_errors_grow(self, swimid: Swimid, tmp_path: Path, noise: dict[str, float]) -> None:
        """The tail beat of one trial is 5 % wider than stated."""
        runs = list(_runs(shared=True))
        wide = runs[0].drive["amplitude_deg"] / 1.05
        runs[0] = replace(runs[0], drive={**runs[0].drive, "amplitude_deg": wide})
        file = _fit(swimid, _write(tmp_path, runs, noise), "--share", "c_f")
        assert file.fit is not None
        assert (file.fit.model_extra or {})["between_trials"]["probability"] > 0.99
        checks = evidence.read(evidence.sidecar(tmp_path / "fit.yaml")).checks
        (check,) = [c for c in checks if c.name == "trials agree"]
        assert check.verdict == "warn"

    @pytest.mark.slow
    def test_standard_errors_stay_if_trials_agree(self, swimid: Swimid, tmp_path: Path) -> None:
        file = _fit(swimid, _write(tmp_path, _runs(shared=True), POSE), "--share", "c_f")
        assert file.fit is not None
        assert (file.fit.model_extra or {})["between_trials"]["probability"] < 0.99


class TestLogs:
    @pytest.mark.slow
    def test_measured_joints_move_the_fish(self, swimid: Swimid, tmp_path: Path) -> None:
        joints = {f"joint{k}_rad": float(np.radians(0.1)) for k in (1, 2, 3)}
        trials = _write(tmp_path, _runs(shared=True), {**RATES, **joints}, with_drive=False)
        file = _fit(swimid, trials, "--share", "c_f", "--channels", ",".join(RATES))
        off = _deviations(file, SHARED)
        # The errors of the measured joints hide the small forces of c_f.
        assert file.parameters["c_f0"].status == "unidentifiable"
        assert len(off) == 5
        assert max(map(abs, off.values())) < 4, off

    @pytest.mark.slow
    def test_commanded_joints_move_the_fish_if_none_is_measured(self, swimid: Swimid, tmp_path: Path) -> None:
        runs = []
        for run in _runs(shared=True):
            names = {f"joint{k}_rad": f"cmd{k}_rad" for k in (1, 2, 3)}
            columns = {names.get(n, n): v for n, v in run.columns.items()}
            runs.append(replace(run, columns=columns))
        columns = [*RATES, "cmd1_rad", "cmd2_rad", "cmd3_rad"]
        trials = _write(tmp_path, runs, RATES, columns=columns, with_drive=False)
        file = _fit(swimid, trials, "--share", "c_f")
        off = _deviations(file, SHARED)
        assert len(off) >= 7
        assert max(map(abs, off.values())) < 3, off

    def test_a_driven_joint_without_a_column(self, swimid: Swimid, tmp_path: Path) -> None:
        columns = [*RATES, "joint1_rad", "joint3_rad"]
        trials = _write(tmp_path, _runs(), RATES, columns=columns, with_drive=False)
        ran = swimid("fit-graybox", trials)
        assert ran.status == 3
        assert "slow.csv" in ran.err
        assert "'joint2_rad'" in ran.err
        assert "cmd2_rad" in ran.err
        assert ran.err.count("Error") == 1

    def test_a_joint_with_zero_gain_needs_no_column(self, tmp_path: Path) -> None:
        drive = _drive(2.0, 20)
        run = swimmer.Run("d", drive, swimmer.simulate("dolphin", None, drive, 2.0))
        columns = ["x_m", "z_m", "pitch_rad", "joint2_rad"]
        path = swimmer.write_trials(tmp_path, "dolphin", [run], {}, 0, columns=columns, with_drive=False)
        experiment = load_experiment(path, start_state="rest")
        (trial,) = experiment.trials
        still, moved = (motion(trial.time_s)[0] for motion in trial.swim.joints)
        assert not still.any()
        assert moved == pytest.approx(run.columns["joint2_rad"], abs=1e-6)

    @pytest.mark.slow
    def test_a_start_in_motion(self, swimid: Swimid, tmp_path: Path) -> None:
        trials = _write(tmp_path, _runs(shared=True), RATES)
        text = trials.read_text()
        for name in ("fast", "held"):
            text = text.replace(f"log: {name}.csv", f"log: {name}.csv\n    start_s: 2.5")
        trials.write_text(text)
        file = _fit(swimid, trials, "--share", "c_f")
        assert file.parameters["initial_surge[fast]"].status == "estimated"
        assert not [n for n in file.parameters if n.startswith("initial") and "fast" not in n]
        columns = next(r for r in _runs(shared=True) if r.id == "fast").columns
        for name, column in (("initial_surge", "u_m_s"), ("initial_yaw_rate", "yaw_rate_rad_s")):
            e = file.parameters[f"{name}[fast]"]
            assert e.stderr
            assert abs(e.value - columns[column][125]) < 3 * e.stderr
        off = _deviations(file, SHARED)
        assert len(off) >= 6
        assert max(map(abs, off.values())) < 3, off
        # the held-out one starts in motion too: its own start state is found before it is scored
        assert file.fit is not None
        for channel, sd in RATES.items():
            assert file.fit.validation["channels"][channel]["rmse"] == pytest.approx(sd, rel=0.25)
        still = _fit(swimid, trials, "--share", "c_f", "--start-state", "rest")
        assert not [n for n in still.parameters if n.startswith("initial")]
        assert still.fit is not None
        assert still.fit.channels["u_m_s"]["rmse"] > 2 * RATES["u_m_s"]

    def test_a_start_from_rest_is_recognised_without_noise(self, tmp_path: Path) -> None:
        for noise in (dict.fromkeys(RATES, 0.0), dict.fromkeys(POSE, 0.0)):
            experiment = load_experiment(_write(tmp_path, _runs(), noise))
            free = [p.name for p in experiment.model.parameters if p.free]
            assert not [name for name in free if name.startswith("initial")]

    @pytest.mark.slow
    def test_a_held_out_run_with_another_start(self, swimid: Swimid, tmp_path: Path) -> None:
        trials = _write(tmp_path, _runs(shared=True), POSE)

        def moved(table: Table) -> Table:
            place = (table["x_m"] + 1j * table["y_m"]) * np.exp(2j) + 5.0 - 3.0j
            return {**table, "x_m": place.real, "y_m": place.imag, "yaw_rad": table["yaw_rad"] + 2.0}

        _rewrite(tmp_path / "held.csv", moved)
        trials.write_text(trials.read_text().replace("log: held.csv", "log: held.csv\n    start_s: 2.0"))
        file = _fit(swimid, trials, "--share", "c_f")
        assert file.fit is not None
        for channel, sd in POSE.items():
            # 200 samples, 8 numbers of its own
            assert file.fit.validation["channels"][channel]["rmse"] == pytest.approx(sd, rel=0.25)

    @pytest.mark.slow
    @pytest.mark.parametrize("late_s", [0.037, -0.037])
    def test_a_clock_with_an_offset(self, swimid: Swimid, tmp_path: Path, late_s: float) -> None:
        trials = _write(tmp_path, _runs(shared=True), POSE)
        _rewrite(tmp_path / "wide.csv", lambda table: {**table, "t_s": table["t_s"] + late_s})
        file = _fit(swimid, trials, "--share", "c_f", "--free", "clock_offset")
        for name, true in (("slow", 0.0), ("wide", late_s), ("fast", 0.0)):
            e = file.parameters[f"clock_offset[{name}]"]
            assert e.stderr
            assert e.stderr < 2e-3
            assert abs(e.value - true) < 3 * e.stderr
        off = _deviations(file, SHARED)
        assert max(map(abs, off.values())) < 3, off

    @pytest.mark.slow
    def test_a_turned_camera(self, swimid: Swimid, tmp_path: Path) -> None:
        trials = _write(tmp_path, _runs(shared=True), POSE)

        def turned(table: Table) -> Table:
            place = (table["x_m"] + 1j * table["y_m"]) * np.exp(0.05j)
            return {**table, "x_m": place.real, "y_m": place.imag}

        for name in ("slow", "fast"):
            _rewrite(tmp_path / f"{name}.csv", turned)
        file = _fit(swimid, trials, "--share", "c_f", "--free", "camera_rotation")
        for name, true in (("slow", 0.05), ("fast", 0.05), ("wide", 0.0)):
            e = file.parameters[f"camera_rotation[{name}]"]
            assert e.stderr
            assert e.stderr < 0.02
            assert abs(e.value - true) < 3 * e.stderr
        off = _deviations(file, SHARED)
        assert max(map(abs, off.values())) < 3, off

    @pytest.mark.slow
    def test_a_drive_that_starts_at_another_phase(self, swimid: Swimid, tmp_path: Path) -> None:
        early = replace(swimmer.tfish(SHARED), lag=np.full(4, -0.4))
        runs = list(_runs(shared=True)[:2])
        runs[1] = replace(runs[1], columns=swimmer.swim(early, runs[1].drive, 6.0, rtol=FINE))
        file = _fit(swimid, _write(tmp_path, runs, RATES), "--share", "c_f", "--free", "drive_phase")
        for name, true in (("slow", 0.0), ("fast", 0.4)):
            e = file.parameters[f"drive_phase[{name}]"]
            assert e.stderr
            assert e.stderr < 0.05
            assert abs(e.value - true) < 3 * e.stderr

    @pytest.mark.slow
    def test_a_rough_log(self, swimid: Swimid, tmp_path: Path) -> None:
        """The log has 30 Hz, a second of rest, gaps, uneven stamps, and a heading within half a turn."""
        rng = np.random.default_rng(3)
        runs = [
            swimmer.Run(r.id, r.drive, swimmer.simulate("tfish", SHARED, r.drive, 8.0, 30.0, rtol=FINE))
            for r in _runs()[:2]
        ]
        before = np.arange(-30, 0) / 30.0
        for run in runs:
            run.columns = {
                n: np.concatenate([before if n == "t_s" else np.zeros(30), v])
                for n, v in run.columns.items()
                if n in ("t_s", *POSE)
            }
        trials = _write(tmp_path, runs, POSE)

        def roughen(table: Table) -> Table:
            table["yaw_rad"] = np.angle(np.exp(1j * (table["yaw_rad"] + 3.0)))
            place = (table["x_m"] + 1j * table["y_m"]) * np.exp(3j)
            table["x_m"], table["y_m"] = place.real, place.imag
            lost = (table["t_s"] > 3.0) & (table["t_s"] < 3.7)
            for name in POSE:
                table[name] = np.where(lost | (rng.random(len(lost)) < 0.05), np.nan, table[name])
            kept = rng.random(len(lost)) < 0.85
            return {n: v[kept] for n, v in table.items()}

        for run in runs:
            _rewrite(tmp_path / f"{run.id}.csv", roughen)
        assert max(np.abs(np.diff(_wrapped(tmp_path / "fast.csv")))) > 6
        file = _fit(swimid, trials, "--share", "c_f")
        assert not [n for n in file.parameters if n.startswith("initial")]
        off = _deviations(file, SHARED)
        assert len(off) >= 6
        assert max(map(abs, off.values())) < 3, off


def _wrapped(path: Path) -> np.ndarray:
    rows = [line.split(",") for line in path.read_text().splitlines()]
    column = rows[0].index("yaw_rad")
    return np.array([float(row[column]) for row in rows[1:] if row[column]])


def _stopping(at: int) -> Callable[..., Any]:
    """Progress that raises Ctrl-C at the given iteration."""

    class Bar:
        def __call__(self, amount: int = 1) -> None:
            pass

        def note(self, text: str) -> None:
            if text.startswith(f"iteration {at},"):
                raise KeyboardInterrupt

    @contextmanager
    def progress(description: str, total: int | None = None) -> Iterator[Step]:
        yield Bar()

    return progress


class TestInterrupted:
    @pytest.mark.slow
    def test_a_fit_continues_from_the_best_point(self, swimid: Swimid, tmp_path: Path) -> None:
        trials = _write(tmp_path, _runs(shared=True), RATES)
        whole = _fit(swimid, trials, "--share", "c_f")
        kept = tmp_path / "kept.yaml"
        with pytest.raises(NoTrustworthyResult, match="start_from") as raised:
            fit_graybox(trials, output=kept, share=["c_f"], progress=_stopping(3))
        assert raised.value.exit_status == 130
        assert "kept.yaml" in str(raised.value)
        assert "interrupted after 3 iterations" in str(raised.value)
        halfway = parameters.read(kept)
        assert halfway.fit is not None
        assert halfway.fit.converged is False
        assert halfway.value("c_ma") not in (1.5, whole.value("c_ma"))
        file = _fit(swimid, trials, "--share", "c_f", "--start-from", str(kept))
        assert file.fit is not None
        assert file.fit.converged
        for name, e in whole.parameters.items():
            if e.stderr:
                assert file.value(name) == pytest.approx(e.value, abs=0.02 * e.stderr)


#: Frequency (Hz), amplitude (deg) and bias (deg) of twelve runs; the first setting comes twice.
TWELVE = (
    (1.0, 25, 0), (1.0, 25, 0), (1.0, 32, 10), (1.4, 20, -12), (1.4, 30, 0), (1.8, 25, 8),
    (0.8, 20, 0), (1.2, 15, 5), (1.6, 20, -8), (1.8, 30, 0), (0.8, 32, -10), (1.4, 25, 6),
)  # fmt: skip


class TestWrongModels:
    """A fit of a model that lacks an effect ends, writes its result, and names the next command."""

    @pytest.mark.slow
    def test_a_fit_with_backlash_takes_no_longer(self, tmp_path: Path) -> None:
        """Twelve runs of a fish with 0.05 rad of servo backlash are compared with the same without."""
        spent = {}
        for name, acts in (("right", []), ("wrong", [swim_actuation.play([0.05] * 3)])):
            folder = tmp_path / name
            gap_trials.write(folder, "tfish", acts, settings=TWELVE, scatter=0.0, seed=7)
            experiment = load_experiment(folder / "trials.yaml")
            result = output_error.fit_output_error(experiment.model, experiment.trials, max_iterations=75)
            spent[name] = result.evaluations
            if name == "right":
                assert result.converged
                assert result.value("c_Ia") == pytest.approx(swimmer.TFISH["c_Ia"], rel=0.2)
        assert spent["wrong"] < 3 * spent["right"]

    @pytest.mark.slow
    def test_an_unfinished_result_is_written(self, swimid: Swimid, tmp_path: Path) -> None:
        trials, out = _write(tmp_path, _runs(), RATES), tmp_path / "fit.yaml"
        ran = swimid("fit-graybox", trials, "--max-iterations", "3", "-o", out)
        assert ran.status == 4
        assert "did not converge: after" in ran.err
        assert f"the result so far is in {out}, marked so" in ran.err
        assert f"swimid diagnose {trials} --params {out}" in ran.err
        assert "check units" in ran.err
        file = parameters.read(out)
        assert file.fit is not None
        assert file.fit.converged is False
        shown = evidence.read(tmp_path / "fit.evidence.json")
        assert shown.verdict.level == "bad"
        assert next(c for c in shown.checks if c.name == "converged").text.startswith("after")

    @pytest.mark.slow
    def test_bounds_that_stopped_the_fit_are_named(self, swimid: Swimid, tmp_path: Path) -> None:
        trials, out = _write(tmp_path, _runs(), RATES), tmp_path / "fit.yaml"
        ran = swimid("fit-graybox", trials, "--bounds", "c_d4=0,3", "--max-iterations", "6", "-o", out)
        assert ran.status == 4
        assert re.search(r"lower the cost; .*c_d4\b.* at a bound", ran.err)


class TestBrokenSimulations:
    @pytest.mark.slow
    def test_broken_simulations_do_not_stop_the_search(self, swimid: Swimid, tmp_path: Path) -> None:
        """These bounds allow links without mass, and negative drag."""
        trials = _write(tmp_path, _runs(shared=True)[:2], RATES)
        wide = ["--share", "c_f", "--bounds", "c_ma=-2,1e4", "--bounds", "c_Ia=-2,1e4"]
        wide += ["--bounds", "c_d4=-100,1e4", "--bounds", "c_d0=-100,1e4"]
        file = _fit(swimid, trials, *wide, "--starts", "4", "--seed", "5")
        off = _deviations(file, SHARED)
        assert len(off) >= 5
        assert max(map(abs, off.values())) < 3, off
        (starts,) = [
            t for t in evidence.read(evidence.sidecar(trials.parent / "fit.yaml")).tables if t.id == "starts"
        ]
        assert len(starts.rows) == 4


class TestBadInput:
    @pytest.mark.parametrize(
        "status, said, options",
        [
            (2, "no channel 'yaw_rate'", ["--channels", "yaw_rate"]),
            (2, "did you mean 'yaw_rate_rad_s'", ["--channels", "yaw_rate_rad"]),
            (2, "'c_x'", ["--share", "c_x"]),
            (2, "no parameter 'c_m'", ["--fix", "c_m=1"]),
            (2, "the lower bound 2.0 must be below 1.0", ["--bounds", "c_ma=2,1"]),
            (2, "no reading 'drag_points'", ["--reading", "drag_points=strips"]),
            (2, "no option 'strip'", ["--reading", "drag_point=strip"]),
            (3, "v_m_s", ["--channels", "v_m_s"]),
            (3, "nothing.yaml", ["--start-from", "nothing.yaml"]),
        ],
    )
    def test_options(
        self, swimid: Swimid, tmp_path: Path, status: int, said: str, options: list[str]
    ) -> None:
        trials = _write(tmp_path, _runs()[:1], RATES)
        ran = swimid("fit-graybox", trials, *options, "-o", tmp_path / "fit.yaml")
        assert ran.status == status, ran.err
        assert said in ran.err
        assert ran.err.count("Error:") == 1
        assert not (tmp_path / "fit.yaml").exists()

    @pytest.mark.parametrize(
        "old, new, said",
        [
            ("robot: tfish", "robot: tfisch", "did you mean 'tfish'"),
            ("robot: tfish", "robot: boxfish", "has no 'multilink' or 'multibody' part"),
            ("experiment: free-swim", "experiment: falling-weight", "'falling-weight' is not allowed"),
            ("experiment: free-swim", "experiment: freeswim", "did you mean 'free-swim'"),
            ("log: slow.csv", "log: sloe.csv", "sloe.csv"),
            ("amplitude_deg: 30", "amplitude_degree: 30", "amplitude_degree"),
        ],
    )
    def test_trials_files(self, swimid: Swimid, tmp_path: Path, old: str, new: str, said: str) -> None:
        trials = _write(tmp_path, _runs()[:1], RATES)
        assert old in trials.read_text()
        trials.write_text(trials.read_text().replace(old, new))
        ran = swimid("fit-graybox", trials, "--json")
        assert ran.status == 3, ran.err
        document = json.loads(ran.out)
        assert document["ok"] is False
        assert document["error"]["exit_status"] == 3
        assert said in ran.err
        assert ran.err.count("Error:") == 1


class TestDolphin:
    @pytest.mark.slow
    def test_nine_coefficients(self, swimid: Swimid, tmp_path: Path) -> None:
        truth = {"c_m0": 0.4, "c_m1": 0.3, "c_m2": 0.2, "c_d0": 2.0, "c_d1": 3.2, "c_d2": 5.0, "c_f1": 0.05}
        noise = {"x_m": 0.005, "z_m": 0.005, "pitch_rad": np.radians(1.0), "joint3_rad": np.radians(1.0)}
        runs = []
        for k, (frequency, amplitude) in enumerate(((1.2, 30), (2.0, 25), (2.9, 25))):
            drive = _drive(frequency, amplitude)
            runs.append(
                swimmer.Run(f"r{k}", drive, swimmer.simulate("dolphin", truth, drive, 6.0, rtol=FINE))
            )
        trials = swimmer.write_trials(tmp_path, "dolphin", runs, noise, 1, columns=list(noise))
        file = _fit(swimid, trials)
        whole = {**swimmer.DOLPHIN, **truth}
        off = _deviations(file, whole)
        unknown = [n for n in whole if n in file.parameters and file.parameters[n].status == "unidentifiable"]
        assert len(off) + len(unknown) == 9
        assert len(off) >= 5
        assert max(map(abs, off.values())) < 3, off
        assert all(any(n in line for line in file.identifiability) for n in unknown)
        assert max(map(abs, _sums(file, whole).values()), default=0.0) < 3
        assert file.fit is not None
        assert set(file.fit.channels) == set(noise)


def _starting_at(model_parameters: Sequence[Parameter], truth: dict[str, float]) -> tuple[Parameter, ...]:
    return tuple(replace(p, start=truth.get(p.name, p.start)) for p in model_parameters)


@pytest.mark.slow
class TestPublishedFish:
    """Write six runs of 20 s with the coefficients of Table III."""

    def test_within_three_standard_errors(self, swimid: Swimid, tmp_path: Path) -> None:
        for drag_at, reading in (("mid-link", "mid-link"), ("slices", "strips")):
            trials = _write(tmp_path / drag_at, _published(drag_at), RATES)
            file = _fit(swimid, trials, "--reading", f"drag_point={reading}")
            off = _deviations(file, swimmer.TFISH)
            assert {"c_ma", "c_Ia", "c_d0", "c_d13", "c_d4"} <= set(off)
            assert max(map(abs, off.values())) < 3, off
            (sum_off,) = _sums(file, swimmer.TFISH).values()
            assert abs(sum_off) < 3

    def test_every_start_ends_in_one_minimum(self, swimid: Swimid, tmp_path: Path) -> None:
        """Starts cover the whole range of Table III."""
        trials = _write(tmp_path, _published("mid-link"), RATES)
        _fit(swimid, trials, "--starts", "8", "--seed", "1")
        found = evidence.read(evidence.sidecar(tmp_path / "fit.yaml"))
        (starts,) = [t for t in found.tables if t.id == "starts"]
        costs = np.array([row[2] for row in starts.rows], dtype=float)
        assert len(costs) == 8
        assert np.ptp(costs) < 1e-4 * costs.min()
        (check,) = [c for c in found.checks if c.name == "one minimum"]
        assert check.verdict == "pass"

    @pytest.mark.parametrize("noise", [RATES, POSE], ids=["rates", "pose"])
    def test_coverage(self, tmp_path: Path, noise: dict[str, float]) -> None:
        """95 % intervals cover the truth over 50 seeds of noise. Fits start at the truth."""
        repeats = 50
        trials = _write(tmp_path, _published("mid-link"), dict.fromkeys(noise, 0.0))
        experiment = load_experiment(trials, start_state="rest", max_step=0.01)
        begin = _starting_at(experiment.model.parameters, swimmer.TFISH)
        inside = dict.fromkeys(swimmer.TFISH, 0)
        sums = []
        for seed in range(repeats):
            rng = np.random.default_rng(1000 + seed)
            noisy = [
                replace(
                    trial,
                    measured={
                        c: trial.measured[c] + rng.normal(0, sd, trial.time_s.size) for c, sd in noise.items()
                    },
                    # the first sample, from which the start offsets count, has its noise too
                    swim=replace(trial.swim, pose=tuple(rng.normal(0, list(POSE.values())))),
                )
                for trial in experiment.trials
            ]
            result = output_error.fit_output_error(experiment.model, noisy, parameters=begin)
            for name, true in swimmer.TFISH.items():
                stderr = result.stderr(name)
                # at its bound a coefficient claims no interval
                inside[name] += stderr is None or abs(result.value(name) - true) < 1.96 * stderr
            for known in uncertainty.combinations(result):
                total = sum(w * swimmer.TFISH[m] for m, w in known.weights.items() if m in swimmer.TFISH)
                sums.append(abs(known.value - total) < 1.96 * known.stderr)
        print(f"95 % intervals that hold the truth, of {repeats}: {inside}; sums {sum(sums)} of {len(sums)}")
        # one in 1000 honest runs has a coefficient below the first limit
        fewest = stats.binom.ppf(1e-3 / len(inside), repeats, 0.95)
        assert min(inside.values()) >= fewest, inside
        # errors of one fit are correlated: as if only a quarter of the intervals were independent
        count = repeats * len(inside)
        spread = np.sqrt(0.95 * 0.05 / (count / 4))
        pooled = sum(inside.values()) / count
        assert abs(pooled - 0.95) < 3 * spread, inside
        if sums:
            assert sum(sums) >= stats.binom.ppf(1e-3, len(sums), 0.95)


def test_a_trial_may_set_its_own_coefficient(swimid: Swimid, tmp_path: Path) -> None:
    """Trials of the dolphin with two stiffnesses are each simulated with their own."""
    drive = {"frequency_hz": 2.5, "amplitude_deg": 27}
    runs = [
        swimmer.Run(f"k{k}", drive, swimmer.simulate("dolphin", {"K_s": k}, drive, 4.0, rtol=FINE))
        for k in (0.31, 0.8)
    ]
    path = swimmer.write_trials(tmp_path, "dolphin", runs, {"u_m_s": 0.005}, 3, columns=["u_m_s"])
    lines = path.read_text().splitlines()
    own = [f"    coefficients: {{K_s: {k}}}" for k in (0.31, 0.8)]
    at = [i for i, line in enumerate(lines) if line.startswith("    drive:")]
    for extra, i in zip(reversed(own), reversed(at), strict=True):
        lines.insert(i + 1, extra)
    path.write_text("\n".join(lines) + "\n")
    fixed = [f"{n}{k}" for n in ("c_m", "c_d", "c_f") for k in (0, 1, 2) if n + str(k) != "c_f1"]
    file = robot_format.read("dolphin").multilink
    assert file is not None
    held = [word for n in fixed for word in ("--fix", f"{n}={file.coefficients[n].value}")]
    result = json.loads(swimid("fit-graybox", path, *held, "--json").out)["result"]
    estimate = result["parameters"]["c_f1"]
    assert abs(estimate["value"] - 0.034) < 3 * estimate["stderr"] + 0.01 * 0.034
    assert result["fit"]["channels"]["u_m_s"]["rmse"] < 0.0055

    path.write_text(path.read_text().replace("K_s: 0.8", "Ks: 0.8"))
    ran = swimid("fit-graybox", path)
    assert ran.status == 3
    assert "did you mean 'K_s'" in ran.err


def test_a_track_of_one_marker_has_an_estimated_heading(tmp_path: Path) -> None:
    """Logs of the sample without heading start in the direction of the track, which is then estimated."""
    folder = tmp_path / "gap"
    shutil.copytree(SAMPLES / "gap", folder)
    whole = load_experiment(SAMPLES / "gap" / "trials.yaml")
    for log in folder.glob("run*.csv"):
        rows = [line.split(",") for line in log.read_text().splitlines() if not line.startswith("#")]
        at = rows[0].index("yaw_rad")
        log.write_text("".join(",".join(row[:at] + row[at + 1 :]) + "\n" for row in rows))
    found = load_experiment(folder / "trials.yaml")
    assert "start_yaw" in {p.name for p in found.model.parameters if p.free}
    for trial, known in zip(found.trials, whole.trials, strict=True):
        off = trial.swim.get_pose()[2] - known.swim.get_pose()[2]
        assert abs((off + np.pi) % (2 * np.pi) - np.pi) < np.pi / 4
    # not where its place is not fitted
    partial = load_experiment(folder / "trials.yaml", channels=["y_m"])
    assert "start_yaw" not in {p.name for p in partial.model.parameters if p.free}
