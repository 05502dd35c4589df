"""``swimid sensitivity``: indices against closed forms, and the command on recorded trials."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files.atomic import Checkpoint
from swimid.fitting.problem import map_in_threads
from swimid.results import evidence
from swimid.sensitivity_analysis import sensitivity
from swimid.sensitivity_analysis.sensitivity import SensitivityFile
from tests.conftest import Ran

Swimid = Callable[..., Ran]

#: Ishigami and Homma (1990): a = 7, b = 0.1, on a cube of side 2 pi.
ISHIGAMI_VARIANCE = 49 / 8 + 0.1 * math.pi**4 / 5 + 0.01 * math.pi**8 / 18 + 0.5
ISHIGAMI_FIRST = [0.5 * (1 + 0.1 * math.pi**4 / 5) ** 2, 49 / 8, 0.0]
ISHIGAMI_TOGETHER = 0.01 * math.pi**8 * (1 / 18 - 1 / 50)
SIDE = math.pi * np.ones(3)


def each(function: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """Of several points, one after the other."""
    return lambda points: np.array([function(x) for x in points])


def ishigami(x: np.ndarray) -> np.ndarray:
    return np.array([np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])])


def linear(x: np.ndarray) -> np.ndarray:
    """Slopes 1, 2, 3 and 4, 0, 0."""
    return np.array([x @ [1.0, 2.0, 3.0], 4 * x[0]])


class TestSobol:
    def test_intervals_contain_the_indices_of_the_ishigami_function(self) -> None:
        found = sensitivity.sobol(each(ishigami), -SIDE, SIDE, samples=1024)
        first = np.array(ISHIGAMI_FIRST) / ISHIGAMI_VARIANCE
        total = first + np.array([1.0, 0.0, 1.0]) * ISHIGAMI_TOGETHER / ISHIGAMI_VARIANCE
        assert np.all((found.first_ci[0, 0] <= first) & (first <= found.first_ci[1, 0]))
        assert np.all((found.total_ci[0, 0] <= total) & (total <= found.total_ci[1, 0]))
        assert found.first_ci[0, 0, 2] < 0 < found.total_ci[0, 0, 2]
        assert found.evaluations == 1024 * 5
        assert found.sd[0] ** 2 == pytest.approx(ISHIGAMI_VARIANCE, rel=0.05)

    def test_indices_of_a_linear_function_are_its_variance_shares(self) -> None:
        """Shares go as slope times range, squared; those of a group as the sums of these."""
        width = np.array([1.0, 1.0, 2.0])
        found = sensitivity.sobol(each(linear), np.zeros(3), width, samples=1024, groups=[[0, 1]])
        parts = np.array([(np.array([1.0, 2.0, 3.0]) * width) ** 2, [16.0, 0.0, 0.0]])
        shares = np.array([*(p / p.sum() for p in parts), parts.sum(axis=0) / parts.sum()])
        for index, ends in ((found.first, found.first_ci), (found.total, found.total_ci)):
            assert np.all((ends[0] <= shares + 1e-12) & (shares <= ends[1] + 1e-12))
            # of a Sobol sequence of 1024 rows; random rows would err by 1 / sqrt(1024)
            assert index == pytest.approx(shares, abs=1 / math.sqrt(1024))
        assert found.mean == pytest.approx([1.0 * 0.5 + 2.0 * 0.5 + 3.0, 2.0], rel=1e-3)
        assert found.sd == pytest.approx(np.sqrt(parts.sum(axis=1) / 12), rel=0.02)

    def test_the_result_depends_on_the_seed_and_not_on_the_threads(self) -> None:
        one, two, other = (
            sensitivity.sobol(each(ishigami), -SIDE, SIDE, samples=64, seed=seed, jobs=jobs)
            for seed, jobs in ((3, 1), (3, 4), (4, 1))
        )
        assert np.array_equal(one.first, two.first)
        assert np.array_equal(one.total_ci, two.total_ci)
        assert not np.array_equal(one.first, other.first)

    def test_a_constant_output_has_no_indices(self) -> None:
        found = sensitivity.sobol(
            each(lambda x: np.array([1.0, x[0]])), np.zeros(2), np.ones(2), samples=64, groups=[[0]]
        )
        assert np.all(found.total[[0, 2]] == 0)
        assert np.isfinite(found.total_ci).all()

    def test_rows_that_break_down_are_left_out(self) -> None:
        """Half a per cent of the range breaks: the rest of it has the same shares, nearly."""

        def breaking(x: np.ndarray) -> np.ndarray:
            return linear(x) if x[2] < 0.995 else np.full(2, np.nan)

        found = sensitivity.sobol(each(breaking), np.zeros(3), np.ones(3), samples=256)
        assert 0 < found.broken < 0.01 * found.evaluations
        assert found.evaluations == 256 * 5
        assert 0 < found.left_out <= found.broken
        assert found.first[0] == pytest.approx(np.array([1.0, 4.0, 9.0]) / 14, abs=1 / math.sqrt(256))
        assert found.mean[0] < 3.0

    def test_many_breakdowns_are_refused(self) -> None:
        def breaking(x: np.ndarray) -> np.ndarray:
            return linear(x) if x[1] < 0.6 else np.full(2, np.inf)

        with pytest.raises(NoTrustworthyResult, match="diverge, more than 1 %") as caught:
            sensitivity.sobol(each(breaking), np.zeros(3), np.ones(3), samples=256, jobs=2)
        assert "--range" in str(caught.value)

    def test_the_number_of_samples_must_be_a_power_of_two(self) -> None:
        with pytest.raises(UsageError, match="power of two"):
            sensitivity.sobol(each(ishigami), -SIDE, SIDE, samples=100)
        with pytest.raises(UsageError, match="two or more"):
            sensitivity.sobol(each(ishigami), -SIDE[:1], SIDE[:1])

    def test_kept_evaluations_are_not_repeated(self, tmp_path: Path) -> None:
        count = 0

        def stopping(x: np.ndarray) -> np.ndarray:
            nonlocal count
            count += 1
            if count == 50:
                raise KeyboardInterrupt
            return ishigami(x)

        path = tmp_path / "kept"
        with pytest.raises(KeyboardInterrupt):
            sensitivity.sobol(each(stopping), -SIDE, SIDE, samples=64, checkpoint=Checkpoint(path, "key"))
        kept = len(path.read_text().splitlines())
        # a line is a batch of points
        assert 49 - sensitivity.ROWS_PER_BATCH <= kept * sensitivity.ROWS_PER_BATCH < 64 * 4
        before = count
        again = sensitivity.sobol(each(stopping), -SIDE, SIDE, samples=64, checkpoint=Checkpoint(path, "key"))
        whole = sensitivity.sobol(each(ishigami), -SIDE, SIDE, samples=64)
        assert count == before + whole.evaluations - kept * sensitivity.ROWS_PER_BATCH
        for name, value in vars(whole).items():
            assert np.array_equal(getattr(again, name), value), name


def test_evaluations_do_not_begin_after_an_interrupt() -> None:
    """Also while whoever waits for the results is busy: here it fills the queue until the interrupt."""
    interrupted, begun = threading.Event(), []

    def work(k: int) -> int:
        begun.append(k)
        if k == 5:
            interrupted.set()
            raise KeyboardInterrupt
        return k

    def items() -> Iterator[int]:
        yield from range(200)
        assert interrupted.wait(60)
        yield from range(200, 400)

    got = []
    with pytest.raises(KeyboardInterrupt), map_in_threads(work, items(), 1) as results:
        got.extend(results)
    assert begun == [0, 1, 2, 3, 4, 5]
    assert got == [0, 1, 2, 3, 4]


# ------------------------------------------------------------ the command


@pytest.fixture(scope="module")
def tfish(tmp_path_factory: pytest.TempPathFactory, samples: Path) -> Path:
    """Two short trials of the samples."""
    folder = tmp_path_factory.mktemp("tfish")
    text = (samples / "tfish" / "trials.yaml").read_text().split("  - id: ")
    kept = [text[0], *(part for part in text if part.startswith(("f14a25", "f18a20b15")))]
    for name in ("f14a25.csv", "f18a20b15.csv"):
        (folder / name).write_text((samples / "tfish" / name).read_text())
    cut = "  - id: ".join(kept).replace("    role: fit\n", "    role: fit\n    end_s: 4\n")
    (folder / "trials.yaml").write_text(cut)
    return folder / "trials.yaml"


def _params(folder: Path, **stderr: float) -> Path:
    """A parameter file of the tendon fish with its published values."""
    known = {
        "c_ma": 1.15971,
        "c_Ia": 1.30205,
        "c_d0": 4.0,
        "c_d13": 0.14055,
        "c_d4": 5.0,
        "c_f0": 0.01229,
        "c_f13": 0.01005,
        "c_f4": 0.0102,
    }
    rows = [
        f"  {n}: {{value: {v}, stderr: {stderr.get(n, 'null')}, unit: '1', status: estimated}}"
        for n, v in known.items()
    ]
    text = "format: swimid-parameters/1\nmodel: multilink\nrobot: tfish\nparameters:\n" + "\n".join(rows)
    path = folder / "params.yaml"
    path.write_text(
        text + "\ncorrelation:\n  names: [c_ma, c_d4]\n  matrix: [[1, 0.9], [0.9, 1]]\n"
        "fit: {trials: [other], converged: true, noise: {x_m: {value_sd: 0.002}}}\n"
    )
    return path


def _run(swimid: Swimid, trials: Path, out: Path, *options: str | Path) -> SensitivityFile:
    ran = swimid("sensitivity", trials, "-o", out, "--jobs", "1", *options)
    assert ran.status == 0, ran.err
    return SensitivityFile.read(out)


def _lasting(file: SensitivityFile) -> dict[str, Any]:
    """All of a file but when and how it was called."""
    data = file.model_dump()
    for name in ("created", "command"):
        del data["provenance"][name]
    return data


class TestCommand:
    @pytest.mark.slow
    def test_sobol_of_recorded_trials(self, swimid: Swimid, tfish: Path, tmp_path: Path) -> None:
        out = tmp_path / "sens.yaml"
        file = _run(swimid, tfish, out, "--samples", "8")
        assert set(file.ranges) == {"c_ma", "c_Ia", "c_d0", "c_d13", "c_d4", "c_f0", "c_f13", "c_f4"}
        assert (file.ranges["c_d4"].low, file.ranges["c_d4"].high) == (0, 6)
        assert file.simulations is not None
        assert file.simulations.evaluated == 8 * 10
        told = {(o.quantity, o.trial) for o in file.outputs}
        assert {
            ("mean_surge_m_s", "f14a25"),
            ("mean_surge_m_s", None),
            ("misfit_yaw_rad", "f18a20b15"),
        } <= told
        # only the biased trial is told to turn
        assert [o.trial for o in file.outputs if o.quantity == "mean_yaw_rate_rad_s"] == ["f18a20b15"]
        for o in file.outputs:
            assert set(o.shares) == set(file.ranges)
            for s in o.shares.values():
                assert s.total.ci95[0] <= s.total.ci95[1]
        beside = evidence.read(evidence.sidecar(out))
        assert {f.id for f in beside.figures} == {"indices"}
        assert any("Saltelli" in line for line in beside.methods)
        assert not list(tmp_path.glob("*.partial"))
        assert {t.id for t in beside.tables} == {"ranges", "totals"}
        assert beside.facts["Method"] == "Sobol, 8 rows (80 points)"

    def test_the_same_seed_gives_the_same_file(self, swimid: Swimid, tfish: Path, tmp_path: Path) -> None:
        options = ("--samples", "4", "--coefficients", "c_d4,c_ma", "--seed", "7")
        first, second = (_run(swimid, tfish, tmp_path / f"{k}.yaml", *options) for k in range(2))
        assert _lasting(first) == _lasting(second)

    def test_a_study_continues_after_an_interrupt(
        self, swimid: Swimid, tfish: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        options = ("--samples", "4", "--coefficients", "c_d4,c_ma")
        whole = _run(swimid, tfish, tmp_path / "whole.yaml", *options)
        plain, calls = sensitivity.StudyRun.outputs, 0

        def stopping(*given: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == 20:
                raise KeyboardInterrupt
            return plain(*given)

        out = tmp_path / "again.yaml"
        monkeypatch.setattr(sensitivity.StudyRun, "outputs", stopping)
        ran = swimid("sensitivity", tfish, "-o", out, "--jobs", "1", *options)
        assert ran.status == 130
        assert f"{out}.partial keeps the computed part: the same command continues from there" in ran.err
        assert not out.exists()
        assert (tmp_path / "again.yaml.partial").exists()
        calls = 100
        again = _run(swimid, tfish, out, *options)
        # 16 points, 2 runs each: 2 at the centre, then 8 whole points before the interrupt
        assert calls - 100 < 2 * 16 + 10
        assert _lasting(again) == _lasting(whole)
        assert not (tmp_path / "again.yaml.partial").exists()

    def test_ranges_may_be_standard_errors(self, swimid: Swimid, tfish: Path, tmp_path: Path) -> None:
        params = _params(tmp_path, c_ma=0.1, c_d4=0.2)
        out = tmp_path / "sens.yaml"
        file = _run(swimid, tfish, out, "--params", params, "--range", "stderr", "--samples", "4")
        assert {n: (r.low, r.high) for n, r in file.ranges.items()} == {
            "c_ma": pytest.approx((0.95971, 1.35971)),
            "c_d4": pytest.approx((4.6, 5.4)),
        }
        (check,) = [c for c in evidence.read(evidence.sidecar(out)).checks if c.name == "ranges independent"]
        assert check.verdict == "warn"
        units = {o.quantity: o.unit for o in file.outputs}
        assert (units["misfit_x_m"], units["misfit_y_m"]) == ("1", "m")

    def test_ranges_may_be_shares_or_given(self, swimid: Swimid, tfish: Path, tmp_path: Path) -> None:
        options = ("--range", "20%", "--range", "d_p=0.01,0.05", "--samples", "2")
        file = _run(swimid, tfish, tmp_path / "sens.yaml", *options)
        assert file.ranges["c_ma"].low == pytest.approx(0.8 * 1.15971)
        assert file.ranges["c_d0"].high == 5.0
        assert (file.ranges["d_p"].low, file.ranges["d_p"].source) == (0.01, "given")

    @pytest.mark.slow
    def test_a_robot_in_space_has_quantities_of_its_cycle(self, swimid: Swimid, tmp_path: Path) -> None:
        time = np.arange(0, 3.0, 1 / 30)
        rows = "\n".join(f"{t:.5f},{0.1 * t:.5f},{-0.01 * t:.5f},0.0" for t in time)
        (tmp_path / "stroke.csv").write_text(f"t_s,x_m,z_m,pitch_rad\n{rows}\n")
        trials = tmp_path / "trials.yaml"
        trials.write_text(
            "format: swimid-trials/1\nexperiment: multibody\nrobot: sealion\ntrials:\n"
            "  - {id: stroke, log: stroke.csv, drive: {stroke: characteristic}}\n"
        )
        file = _run(
            swimid, trials, tmp_path / "sens.yaml", "--samples", "2",
        )  # fmt: skip
        assert set(file.ranges) == {"water_volume", "com_offset", "z_added_mass", "z_drag"}
        quantities = {o.quantity for o in file.outputs}
        assert {"max_speed_m_s", "final_pitch_rad", "surge_m", "heave_m", "misfit_pitch_rad"} <= quantities

    @pytest.mark.parametrize(
        ("options", "text"),
        [
            (("--samples", "100"), "power of two"),
            (("--range", "c_d=1,2"), "no coefficient 'c_d'"),
            (("--range", "c_d4=2,1"), "is empty"),
            (("--range", "c_d4=a,1"), "NAME=LOW,HIGH"),
            (("--range", "much"), "should be bounds, stderr"),
            (("--range", "stderr"), "--params"),
            (("--set", "c_d4=3", "--coefficients", "c_d4"), "fixed by --set"),
            (("--coefficients", "initial_surge"), "no coefficient"),
            (("--coefficients", "c_d4"), "two or more"),
        ],
    )  # fmt: skip
    def test_bad_options_are_refused(
        self, swimid: Swimid, tfish: Path, options: tuple[str, ...], text: str
    ) -> None:
        ran = swimid("sensitivity", tfish, *options)
        assert ran.status == 2
        assert text in ran.err

    def test_a_robot_of_one_body(self, swimid: Swimid, samples: Path) -> None:
        trials = samples / "rig" / "trials.yaml"
        ran = swimid("sensitivity", trials, "--range", "20%", "--samples", "8", "--json")
        assert ran.status == 0, ran.err
        outputs = ran.json["result"]["outputs"]
        assert {one["quantity"] for one in outputs} == {"misfit_x_m"}
        # the drag decides how far the drops of a boxfish are off
        shares = {name: one["total"]["value"] for name, one in outputs[-1]["shares"].items()}
        assert max(shares, key=shares.__getitem__) == "drag_coefficient"

    def test_many_breakdowns_of_a_robot_are_refused(
        self, swimid: Swimid, tfish: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "sens.yaml"
        ran = swimid("sensitivity", tfish, "-o", out, "--samples", "8", "--range", "c_ma=-3,3")
        assert ran.status == 4
        assert "diverge" in ran.err
        assert not out.exists()

    def test_another_file_format_is_refused(self, tfish: Path) -> None:
        with pytest.raises(InputError, match="no sensitivity file"):
            SensitivityFile.read(tfish)
