"""Readers and writers of every format: what is written reads back, what is broken says where."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from swimid.errors import InputError, UsageError
from swimid.files import atomic, yamlio
from swimid.logs import log, trials
from swimid.notices import record_warnings
from swimid.propulsion import trials as cruise
from swimid.results import evidence, parameters
from swimid.robots import file as robot


def _file(folder: Path, text: str, name: str = "x.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


class TestLog:
    def test_round_trip_keeps_every_bit(self, tmp_path: Path, rng: np.random.Generator) -> None:
        columns = {
            "t_s": np.cumsum(rng.random(50)),
            "x_m": rng.normal(size=50) * 10.0 ** rng.integers(-12, 12, 50),
        }
        for name in ("a.csv", "a.parquet"):
            log.write(tmp_path / name, columns, {"robot": "boxfish", "pulling_mass_kg": 0.01, "list": [1, 2]})
            back = log.read(tmp_path / name, required=("x_m",), optional=())
            assert np.array_equal(back["t_s"], columns["t_s"])
            assert np.array_equal(back["x_m"], columns["x_m"])
            assert back.metadata == {"robot": "boxfish", "pulling_mass_kg": 0.01, "list": [1, 2]}

    def test_missing_samples_are_nan_and_counted(self, tmp_path: Path) -> None:
        path = _file(tmp_path, "t_s,x_m\n0,1\n1,\n2,\n3,4\n")
        with record_warnings() as notices:
            read = log.read(path, required=("x_m",))
        assert np.isnan(read["x_m"]).sum() == 2
        assert [n.code for n in notices] == ["SWM001"]
        assert "2 of 4" in notices[0].text
        assert "longest run 2" in notices[0].text

    def test_text_column_that_nobody_asked_for_is_left_out(self, tmp_path: Path) -> None:
        read = log.read(_file(tmp_path, "t_s,x_m,status\n0,1,ok\n1,2,lost\n"))
        assert set(read.columns) == {"t_s", "x_m"}

    def test_columns_that_nobody_asked_for_may_hold_anything(self, tmp_path: Path) -> None:
        path = _file(tmp_path, 't_s,x_m,note,y_m\n0,1,"a, b",?\n1,2,"5""",\n')
        assert set(log.read(path, required=("x_m",), optional=()).columns) == {"t_s", "x_m"}

    def test_quotation_mark_in_a_comment(self, tmp_path: Path) -> None:
        read = log.read(_file(tmp_path, '# fin: 5" long\nt_s,x_m\n0,1\n1,2\n'))
        assert len(read) == 2
        assert read.line(0) == 3

    def test_long_logs_keep_every_bit(self, tmp_path: Path, rng: np.random.Generator) -> None:
        """Numbers of every size and digit, in more samples than are written or read at once."""
        bits = rng.integers(0, 2**64, 250_000, dtype=np.uint64).view(float)
        columns = {"t_s": np.arange(250_000) / 3.0, "k": bits, "x_m": rng.normal(size=250_000)}
        for name in ("k", "x_m"):
            # A log holds values of up to 1e30.
            here = (np.abs(columns[name]) < 1e30) & (rng.random(250_000) > 0.01)
            columns[name] = np.where(here, columns[name], np.nan)
        log.write(tmp_path / "a.csv", columns, {"robot": "boxfish"})
        back = log.read(tmp_path / "a.csv")
        for name, values in columns.items():
            assert np.array_equal(back[name], values, equal_nan=True)

    def test_parquet_needs_its_extra(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        columns = {"t_s": np.arange(3.0), "x_m": np.arange(3.0)}
        log.write(tmp_path / "a.parquet", columns)
        monkeypatch.setitem(sys.modules, "pyarrow", None)
        monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
        with pytest.raises(UsageError, match=r"swimid\[parquet\]"):
            log.read(tmp_path / "a.parquet")
        with pytest.raises(UsageError, match=r"swimid\[parquet\]"):
            log.write(tmp_path / "b.parquet", columns, {})
        assert not (tmp_path / "b.parquet").exists()

    def test_blank_lines_at_the_end_are_no_samples(self, tmp_path: Path) -> None:
        assert len(log.read(_file(tmp_path, "t_s,x_m\n0,1\n1,2\n\n\n"))) == 2

    @pytest.mark.parametrize(
        "text, words",
        [
            ("", ["is empty"]),
            ("# only: this\n", ["comments only"]),
            ("t_s,x_m\n", ["no samples"]),
            ("t_s,y_m\n0,1\n1,2\n", ["line 1", "'x_m'", "missing", "did you mean 'y_m'"]),
            ("t_s,x\n0,1\n1,2\n", ["line 1", "'x_m'", "did you mean 'x'"]),
            ("t_s;x_m\n0;1\n", ["semicolons"]),
            ("0,1\n1,2\n", ["header line"]),
            ("x_m,t_s\n1,0\n2,1\n", ["first column must be t_s"]),
            ("t_s,x_m,x_m\n0,1,1\n1,2,2\n", ["two columns"]),
            ("# a: 1\nt_s,x_m\n0,1\n1,abc\n", ["line 4", "'x_m'", "'abc' is not a number"]),
            ("t_s,x_m\n0,1\n1,2,3\n", ["line 3", "3 cells", "2 columns"]),
            ("t_s,x_m\n0,1,\n1,2,\n", ["line 2", "3 cells", "2 columns"]),
            ("t_s,x_m,y_m\n0,1,2\n1,2\n2,3,4\n", ["line 3", "2 cells", "3 columns"]),
            ("t_s,x_m,y_m\n0,1,2\n1,2,3,4\n2,3\n", ["line 3", "4 cells", "3 columns"]),
            ('t_s,x_m\n0,"1\n1,2\n', ["line 2", "unreadable cells"]),
            ("t_s,x_m\n0,1\n1,2\n1,3\n", ["line 4", "'t_s'", "time repeats"]),
            ("t_s,x_m\n0,1\n2,2\n1,3\n", ["line 4", "'t_s'", "time goes back"]),
            ("t_s,x_m\n0,1\n,2\n2,3\n", ["line 3", "'t_s'", "no value"]),
            ("t_s,x_m\n0,inf\n1,2\n", ["line 2", "'x_m'", "infinite"]),
            ("t_s,x_m\n0,\n1,\n", ["'x_m'", "every sample is missing"]),
        ],
    )
    def test_each_fault_names_its_place(self, tmp_path: Path, text: str, words: list[str]) -> None:
        with pytest.raises(InputError) as caught:
            log.read(_file(tmp_path, text), required=("x_m",))
        for word in ["x.csv", *words]:
            assert word in str(caught.value)

    def test_binary_and_absent_files(self, tmp_path: Path) -> None:
        (tmp_path / "b.csv").write_bytes(bytes(range(256)) * 10)
        with pytest.raises(InputError, match=r"b\.csv"):
            log.read(tmp_path / "b.csv")
        with pytest.raises(InputError, match="No such file"):
            log.read(tmp_path / "absent.csv")
        with pytest.raises(InputError, match="No such file"):
            log.read(tmp_path / "absent.parquet")
        (tmp_path / "c.parquet").write_bytes(b"PAR1 no, not really")
        with pytest.raises(InputError, match="no readable Parquet"):
            log.read(tmp_path / "c.parquet")
        with pytest.raises(InputError, match="is a folder; a file is needed here"):
            log.read(tmp_path)

    @pytest.mark.parametrize(
        "text, word",
        [
            ("t_s,x_m\n0,0\n33,1\n66,1\n" + "".join(f"{33 * k},1\n" for k in range(3, 90)), "milliseconds"),
            ("t_s,x_m\n0,0\n1,1150\n2,2300\n", "millimetres"),
            ("t_s,u_m_s\n0,0\n1,210\n2,230\n", "millimetres per second"),
            ("t_s,yaw_rad\n0,170\n1,179\n2,-179\n", "degrees"),
            ("t_s,joint1_rad\n0,0\n0.1,15\n0.2,30\n", "degrees"),
            ("t_s,yaw_rate_rad_s\n0,0\n1,90\n2,120\n", "degrees per second"),
        ],
    )
    def test_wrong_units_are_suspected(self, tmp_path: Path, text: str, word: str) -> None:
        with record_warnings() as notices:
            log.read(_file(tmp_path, text))
        assert any(n.code == "SWM002" and word in n.text for n in notices), notices

    def test_ordinary_logs_raise_no_suspicion(self, tmp_path: Path) -> None:
        with record_warnings() as notices:
            log.read(
                _file(
                    tmp_path,
                    "t_s,x_m,yaw_rad,yaw_rate_rad_s,u_m_s\n0,0,3.1,0,0\n0.5,0.2,-3.1,9,1\n1,0.4,3,-9,0\n",
                )
            )
        assert notices == []


class TestYaml:
    @pytest.mark.slow
    @pytest.mark.parametrize(
        "text, words",
        [
            ("", ["is empty"]),
            ("- a\n- b\n", ["top level"]),
            ("a: [1, 2\n", ["not valid YAML", "line"]),
            ("a: 1\nb: 2\na: 3\n", ["line 3", "duplicate key"]),
            ("a: &a [*a]\n", ["line 1, 'a'"]),
            (
                "a0: &a0 [1, 2]\n"
                + "".join(f"a{k}: &a{k} [{', '.join(10 * [f'*a{k - 1}'])}]\n" for k in range(1, 10)),
                ["anchors"],
            ),
            ("a: " + "[" * 3000 + "]" * 3000, ["not valid YAML"]),
            ("a: !!python/object/apply:os.system [echo]\n", ["x.yaml"]),
            ("a: \x00\n", ["x.yaml"]),
        ],
    )
    def test_broken_documents(self, tmp_path: Path, text: str, words: list[str]) -> None:
        class Any1(yamlio.Document):
            a: int

        with pytest.raises(InputError) as caught:
            yamlio.read_document(_file(tmp_path, text, "x.yaml"), Any1)
        for word in words:
            assert word in str(caught.value)

    def test_floats_survive_to_the_last_bit(self, tmp_path: Path, rng: np.random.Generator) -> None:
        values = [float(v) for v in rng.normal(size=200) * 10.0 ** rng.integers(-300, 300, 200)] + [
            1e-5,
            1e22,
            5e-324,
        ]
        yamlio.write(tmp_path / "f.yaml", {"values": values, "deep": {"leaf": {"v": values[0]}}})
        back = yamlio.load(tmp_path / "f.yaml")
        assert list(back["values"]) == values
        assert back["deep"]["leaf"]["v"] == values[0]

    def test_numbers_are_numbers_for_older_readers_too(self) -> None:
        """YAML 1.1 takes 1e-05 for text; a point makes it a number everywhere."""
        assert "1.0e-05" in yamlio.dumps({"a": 1e-5})


TRIALS = "format: swimid-trials/1\nexperiment: falling-weight\nrobot: boxfish\n"


class TestTrials:
    @pytest.mark.parametrize(
        "text, words",
        [
            ("a: 1\n", ["no trials file"]),
            (
                "format: swimid-trials/1\nexperiment: falling-weigth\nrobot: boxfish\n",
                ["line 2", "did you mean 'falling-weight'"],
            ),
            (TRIALS, ["'trials' is missing"]),
            (TRIALS + "trials: []\n", ["line 4", "trials"]),
            (
                TRIALS + "trials:\n  - log: a.csv\n    puling_mass_kg: 0.01\n",
                ["line 6", "did you mean 'pulling_mass_kg'"],
            ),
            (
                TRIALS + "trials:\n  - log: a.csv\n    pulling_mass_kg: ten\n",
                ["line 6", "'ten' is not allowed"],
            ),
            (TRIALS + "trials:\n  - log: a.csv\n    pulling_mass_kg: -0.1\n", ["line 6", "greater than 0"]),
            (TRIALS + "trials:\n  - log: a.csv\n", ["line 5", "pulling_mass_kg"]),
            (
                TRIALS
                + "trials:\n  - {log: a.csv, pulling_mass_kg: 0.1}\n  - {log: a.csv, pulling_mass_kg: 0.1}\n",
                ["line 6", "two trials"],
            ),
            (
                TRIALS + "trials:\n  - {log: a.csv, pulling_mass_kg: 0.1, role: test}\n",
                ["line 5", "'fit' or 'validate'"],
            ),
            (TRIALS + "trials:\n  - {log: a.csv, pulling_mass_kg: .nan}\n", ["line 5"]),
            (TRIALS.replace("boxfish", "[1]") + "trials: []\n", ["robot"]),
        ],
    )
    def test_each_fault_names_its_place(self, tmp_path: Path, text: str, words: list[str]) -> None:
        with pytest.raises(InputError) as caught:
            trials.read(_file(tmp_path, text, "t.yaml"))
        for word in ["t.yaml", *words]:
            assert word in str(caught.value)

    def test_id_defaults_to_the_log(self, tmp_path: Path) -> None:
        read = trials.read(
            _file(tmp_path, TRIALS + "trials:\n  - {log: logs/w10.csv, pulling_mass_kg: 0.01}\n", "t.yaml")
        )
        assert read.trials[0].id == "w10.csv"

    def test_unknown_robot_suggests_one(self) -> None:
        with pytest.raises(InputError, match="did you mean 'boxfish'"):
            robot.read("boxfsh")

    @pytest.mark.parametrize("name", robot.list_built_in_robots())
    def test_built_in_robots_are_valid(self, name: str) -> None:
        assert robot.read(name).name == name


class TestCruiseTable:
    HEADER = "fin,frequency_hz,amplitude_deg,distance_m,time_s\n"

    @pytest.mark.parametrize(
        "text, words",
        [
            ("", ["is empty"]),
            ("fin,frequency_hz\nA,1\n", ["amplitude_deg", "missing"]),
            (HEADER, ["no line with a run"]),
            (HEADER + "A,2,16,1.15,x\n", ["line 2", "time_s", "'x' is not a number"]),
            (HEADER + "A,2,16,1.15,10\nA,0,16,1.15,10\n", ["line 3", "frequency_hz", "not positive"]),
            (HEADER + "A,,16,1.15,10\n", ["line 2", "frequency_hz", "no value"]),
            # a cell too many in every row shifts nothing silently
            (HEADER + "A,2,16,1.15,10,\n", ["line 2", "6 cells", "5 columns"]),
            (HEADER + "# remark\n\nA,2,16,1.15\n", ["line 4", "4 cells"]),
            (HEADER + "A,2,16,1.15,\n", ["time_s", "every run's value is missing"]),
            (HEADER + "A,2,16,1.15,1e-320\n", ["line 2", "time_s", "the speed is inf"]),
            (
                HEADER.replace("time_s", "time"),
                ["line 1", "a column time_s or mean_speed_m_s is needed", "did you mean 'time'"],
            ),
            (HEADER.replace(",", ";"), ["line 1", "semicolons"]),
        ],
    )
    def test_each_fault_names_its_place(self, tmp_path: Path, text: str, words: list[str]) -> None:
        with pytest.raises(InputError) as caught:
            cruise.read_table(_file(tmp_path, text))
        for word in ["x.csv", *words]:
            assert word in str(caught.value)

    def test_mean_speed_or_time(self, tmp_path: Path) -> None:
        by_time = cruise.read_table(_file(tmp_path, self.HEADER + "A,2,16,1.15,11.5\n"))
        by_speed = cruise.read_table(
            _file(tmp_path, self.HEADER.replace("time_s", "mean_speed_m_s") + "A,2,16,1.15,0.1\n")
        )
        assert by_time.mean_speed_m_s == pytest.approx(by_speed.mean_speed_m_s)


class TestParameters:
    def test_round_trip_keeps_every_bit(self, tmp_path: Path, rng: np.random.Generator) -> None:
        file = parameters.ParameterFile(
            model="arx",
            robot="long-fin",
            parameters={
                f"a{k}": parameters.Estimate(
                    value=float(v), stderr=float(abs(v)), unit="1", status="estimated"
                )
                for k, v in enumerate(rng.normal(size=20) * 10.0 ** rng.integers(-20, 20, 20))
            },
            correlation=parameters.Correlation(names=["a0", "a1"], matrix=[[1.0, 1 / 3], [1 / 3, 1.0]]),
            poles=[parameters.Pole(real=0.1, imag=1 / 7, magnitude=0.9)],
            stable=True,
            delay=1,
            sample_time_s=0.02375,
            fit=parameters.Fit(trials=["a"], converged=True, channels={"x_m": {"rmse": 1 / 3}}),
        )
        file.write(tmp_path / "p.yaml")
        assert parameters.read(tmp_path / "p.yaml") == file

    def test_unidentifiable_values_are_not_used_further(self, tmp_path: Path) -> None:
        e = parameters.Estimate(value=1.0, stderr=9.0, unit="1", status="unidentifiable")
        file = parameters.ParameterFile(model="falling-weight", parameters={"drag_coefficient": e})
        with pytest.raises(InputError, match="not identifiable"):
            parameters.require(file, ("drag_coefficient",), "drag.yaml")

    def test_wrong_model_and_wrong_file(self, tmp_path: Path) -> None:
        file = parameters.ParameterFile(model="arx", parameters={})
        file.write(tmp_path / "p.yaml")
        with pytest.raises(InputError, match="'arx', not of falling-weight"):
            parameters.read(tmp_path / "p.yaml", model="falling-weight")
        with pytest.raises(InputError, match="no parameter file"):
            parameters.read(_file(tmp_path, "format: other\n", "q.yaml"))


class TestAtomic:
    def test_failure_leaves_the_old_file(self, tmp_path: Path) -> None:
        path = _file(tmp_path, "old")

        def fail_halfway() -> None:
            with atomic.replace_file(path) as temporary:
                temporary.write_text("half")
                raise RuntimeError

        with pytest.raises(RuntimeError):
            fail_halfway()
        assert path.read_text() == "old"
        assert list(tmp_path.iterdir()) == [path]

    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
    def test_devices_are_written_to_and_never_replaced(self) -> None:
        with pytest.raises(InputError, match="No space left"):
            atomic.write_text("/dev/full", "a")
        assert Path("/dev/full").is_char_device()
        atomic.write_text("/dev/null", "a")
        assert Path("/dev/null").is_char_device()


class TestEvidence:
    def test_round_trip_and_nan(self, tmp_path: Path) -> None:
        trace = evidence.Trace(x=np.array([0.0, 1.0]), y=np.array([1.0, np.nan]))
        panel = evidence.Panel(x_label="t", y_label="y", traces=[trace])
        page = evidence.Evidence(
            command="rwls",
            title="<b>",
            verdict=evidence.Verdict(level="good", text="fine"),
            figures=[evidence.Figure(id="f", title="f", caption="c", panels=[panel])],
        )
        evidence.write(tmp_path / "e.json", page)
        back = evidence.read(tmp_path / "e.json")
        assert back == page
        assert back.figures[0].panels[0].traces[0].y == [1.0, None]

    @pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "other"}'])
    def test_broken(self, tmp_path: Path, text: str) -> None:
        with pytest.raises(InputError):
            evidence.read(_file(tmp_path, text, "e.json"))

    def test_thinning_keeps_peaks(self, rng: np.random.Generator) -> None:
        x, y = np.arange(100000.0), rng.normal(size=100000)
        y[12345] = 50.0
        thin_x, thin_y = evidence.thin_curve(x, y, 500)
        assert len(thin_x) <= 500
        assert thin_y.max() == 50.0
        assert np.all(np.diff(thin_x) > 0)
