"""The functions do in memory what the commands do with files, and write nothing unless asked."""

from __future__ import annotations

import inspect
import re
import runpy
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
import yaml
from matplotlib.figure import Figure

import swimid
from swimid import api

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "sample_logs"
#: Sections of a docstring, in the order of numpydoc.
SECTIONS = (
    "Parameters", "Attributes", "Returns", "Raises", "Warns", "See Also", "Notes", "References", "Examples",
)  # fmt: skip
#: Lines of a provenance that tell of the moment: its time, and what was imported by then.
MOMENT = re.compile(r"\s+(created|packages):")


def in_memory(folder: str) -> swimid.TrialSet:
    """A sample's trials as tables."""
    listed = yaml.safe_load((SAMPLES / folder / "trials.yaml").read_text())
    trials = [
        {**t, "id": t.get("id", t["log"]), "log": pd.read_csv(SAMPLES / folder / t["log"], comment="#")}
        for t in listed["trials"]
    ]
    return swimid.load(trials, experiment=listed["experiment"], robot=listed["robot"])


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working folder, which must be empty at the end."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def drag() -> swimid.Fitted:
    return swimid.fit_drag(SAMPLES / "rig" / "trials.yaml")


def without_origin(data: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in data.items() if key != "provenance"}


class TestNames:
    def test_every_name_is_found_and_told(self) -> None:
        manual = (ROOT / "docs" / "api.md").read_text()
        for name in api.NAMES:
            assert getattr(swimid, name) is not None
            assert f"`{name}`" in manual, f"{name} is not in docs/api.md"
        assert set(api.NAMES) < set(dir(swimid))

    @pytest.mark.parametrize("name", api.NAMES)
    def test_every_docstring_is_complete(self, name: str) -> None:
        public = getattr(swimid, name)
        told = inspect.getdoc(public) or ""
        sections = re.findall(r"^([A-Z][A-Za-z ]+)\n-+$", told, re.MULTILINE)
        assert sections == [section for section in SECTIONS if section in sections]
        if inspect.isclass(public):
            assert {"Parameters", "Attributes"} & set(sections)
            return
        parameters = inspect.signature(public).parameters
        missing = {"Returns", "Examples"} - set(sections)
        if parameters:  # what takes nothing can refuse nothing
            missing |= {"Parameters", "Raises"} - set(sections)
        assert not missing
        for parameter in parameters:
            assert re.search(rf"^(\*\*)?{parameter}( :|$)", told, re.MULTILINE), parameter


class TestTrials:
    def test_tables_give_what_files_give(self, empty: Path, drag: swimid.Fitted) -> None:
        found = swimid.fit_drag(in_memory("rig"))
        assert without_origin(found.to_dict()) == without_origin(drag.to_dict())
        # only files say in their comments that they are simulated
        assert found.summary() == drag.summary().replace("data simulated; ", "")
        mine, theirs = found.evidence, drag.evidence
        assert mine is not None
        assert theirs is not None
        facts = {name: text for name, text in theirs.facts.items() if name != "Data"}
        alike = theirs.model_copy(update={"facts": facts, "provenance": mine.provenance})
        assert mine.model_dump() == alike.model_dump()

    def test_time_may_be_the_index_and_text_is_left_out(self) -> None:
        frame = pd.DataFrame(
            {"x_m": [0.0, 0.1], "status": ["seen", "seen"]}, index=pd.Index([0.0, 0.1], name="t_s")
        )
        assert list(swimid.Log.from_frame(frame).columns) == ["t_s", "x_m"]

    def test_unknown_keys_are_refused_as_in_a_file(self) -> None:
        log = pd.DataFrame({"t_s": [0.0, 0.1], "x_m": [0.0, 0.1]})
        with pytest.raises(swimid.InputError, match="pulling_mass_g"):
            swimid.load([{"log": log, "pulling_mass_g": 10}], experiment="falling-weight", robot="boxfish")
        with pytest.raises(swimid.UsageError, match="did you mean 'falling-weight'"):
            swimid.load([{"log": log}], experiment="falling-wait", robot="boxfish")
        with pytest.raises(swimid.UsageError, match="experiment or robot of these trials is missing"):
            swimid.load([{"log": log}])

    @pytest.mark.parametrize("kind", ["log", "table", "copy"])
    def test_rows_held_out_must_not_be_fitted(self, kind: str) -> None:
        table = pd.read_csv(SAMPLES / "rig" / "w10.csv", comment="#")
        held = swimid.Log.from_frame(table, name="w10") if kind == "log" else table
        trials = [
            {
                "id": role,
                "log": held.copy() if kind == "copy" else held,
                "role": role,
                "pulling_mass_kg": 0.01,
            }
            for role in ("fit", "validate")
        ]
        with pytest.raises(swimid.InputError, match="share its rows"):
            swimid.fit_drag(swimid.load(trials, experiment="falling-weight", robot="boxfish"))


def test_the_whole_chain_of_the_boxfish(empty: Path, drag: swimid.Fitted) -> None:
    """Drag, then the recoil law with it, then measured against simulated and a course: all in memory."""
    table = pd.read_csv(SAMPLES / "cruise" / "speeds.csv", comment="#")
    runs = swimid.load(table, experiment="cruise", robot="boxfish")
    with pytest.warns(swimid.SwimidWarning):
        propulsion = swimid.fit_propulsion(runs, drag=drag)
    file = swimid.fit_propulsion(SAMPLES / "cruise" / "trials.yaml", drag=drag)
    assert propulsion.parameters.equals(file.parameters)
    scores = swimid.compare(runs, params=propulsion).scores
    assert set(scores["trial"]) == set(table["fin"])
    course = swimid.simulate(
        params=propulsion, fin=str(table["fin"][0]), frequency_hz=2.0, amplitude_deg=20.0, distance_m=2.0
    )
    assert course.frame["mean_speed_m_s"].iloc[0] > 0


def test_several_runs_are_saved_into_a_folder(tmp_path: Path, drag: swimid.Fitted) -> None:
    """Into a new one and into the one that is there; one log cannot take them."""
    runs = swimid.simulate(params=drag, trials=SAMPLES / "rig" / "trials.yaml")
    for _ in range(2):
        saved = runs.save(tmp_path / "simulated")
        assert sorted(p.stem for p in saved.outputs) == sorted(runs.runs)
        assert all(p.is_file() for p in saved.outputs)
    with pytest.raises(swimid.UsageError, match="do not fit into one log"):
        runs.save(tmp_path / "simulated.csv")


def test_black_box_models_of_tables(empty: Path) -> None:
    logs = [SAMPLES / "longfin" / f"longfin_{name}.csv" for name in ("marching", "validation")]
    tables = [pd.read_csv(path, comment="#") for path in logs]
    options: dict[str, Any] = {"input_column": "cmd1_rad", "output_column": "u_m_s", "na": 4, "nb": 3}
    mine = swimid.rwls([tables[0]], held_out=[swimid.Log.from_frame(tables[1], name="other")], **options)
    theirs = swimid.rwls([logs[0]], held_out=[logs[1]], **options)
    assert mine.parameters.equals(theirs.parameters)
    bare = swimid.rwls([tables[0]], held_out=[tables[1]], **options)
    assert bare.parameters.equals(theirs.parameters)
    assert set(bare.file.provenance["inputs"]) == {"table 1", "table 2"}
    with pytest.raises(swimid.InputError, match="share its rows"):
        swimid.rwls([tables[0]], held_out=[tables[0].copy()], **options)


class TestResult:
    def test_numbers_are_at_hand(self, drag: swimid.Fitted) -> None:
        row = drag.parameters.loc["added_mass"]
        assert row["value"] == drag["added_mass"].value
        assert row["low95"] < row["value"] < row["high95"]
        assert drag.correlation.loc["added_mass", "added_mass"] == pytest.approx(1.0)
        assert drag.has_converged
        assert drag.verdict == "good"
        assert set(drag.checks()["verdict"]) == {"pass"}
        assert "methods" in drag.tables()

    def test_figures_are_drawn(self, drag: swimid.Fitted) -> None:
        drawn = drag.figures()
        assert list(drawn) == drag.figure_names
        assert all(isinstance(figure, Figure) and figure.axes for figure in drawn.values())

    def test_a_figure_goes_on_axes_of_the_users(self, drag: swimid.Fitted) -> None:
        before = dict(mpl.rcParams)
        left, right = Figure().subplots(1, 2)
        drag.plot("residuals-x_m", [left, right])
        assert left.lines
        assert right.get_xlabel() == "lag (samples)"
        assert dict(mpl.rcParams) == before
        with pytest.raises(swimid.UsageError, match="2 panels"):
            drag.plot("residuals-x_m", left)
        with pytest.raises(swimid.UsageError, match="there is no figure 'x'"):
            drag.plot("x")

    def test_a_notebook_shows_and_saves_the_figure(self, drag: swimid.Fitted, tmp_path: Path) -> None:
        from matplotlib import pyplot

        drawn, *others = drag.plot("overlay-x_m")  # the worst, the best and the held-out trial
        assert len(others) == 2
        # what the inline backend shows at the end of a cell, and what pyplot.savefig saves
        assert drawn is pyplot.gcf().axes[0]
        pyplot.savefig(tmp_path / "x.svg")
        pyplot.close("all")
        assert (tmp_path / "x.svg").stat().st_size > 10_000

    def test_a_result_and_its_trials_are_one_line(self, drag: swimid.Fitted) -> None:
        assert re.fullmatch(r"<Fitted of fit-drag: good, \d+ figures>", repr(drag))
        trials = swimid.load(SAMPLES / "rig" / "trials.yaml")
        assert repr(trials) == "<TrialSet trials.yaml: falling-weight, 7 trials>"

    def test_saved_and_loaded_it_is_the_same(self, drag: swimid.Fitted, tmp_path: Path) -> None:
        saved = drag.save(tmp_path / "drag.yaml")
        assert sorted(p.name for p in saved.outputs) == ["drag.evidence.json", "drag.yaml"]
        again = swimid.load_result(tmp_path / "drag.yaml")
        assert isinstance(again, swimid.Fitted)
        assert again.parameters.equals(drag.parameters)
        assert again.evidence == drag.evidence
        assert "added_mass" in again.summary()

    def test_an_output_is_written_as_the_command_writes_it(self, drag: swimid.Fitted, tmp_path: Path) -> None:
        swimid.fit_drag(SAMPLES / "rig" / "trials.yaml", output=str(tmp_path / "a.yaml"))
        drag.save(tmp_path / "b.yaml")
        a, b = (
            [x for x in (tmp_path / f"{n}.yaml").read_text().splitlines() if not MOMENT.match(x)]
            for n in "ab"
        )
        assert a == b

    def test_any_result_is_read_back(self, tmp_path: Path) -> None:
        (tmp_path / "x.yaml").write_text("format: other/1\n")
        with pytest.raises(swimid.InputError, match="other/1"):
            swimid.load_result(tmp_path / "x.yaml")
        log = swimid.load_result(SAMPLES / "rig" / "w10.csv")
        assert isinstance(log, swimid.Logged)
        assert list(log.frame) == ["t_s", "x_m"]

    def test_a_page_of_results_that_were_not_written(self, empty: Path, drag: swimid.Fitted) -> None:
        page = swimid.report([drag])
        assert page.document.startswith("<!DOCTYPE html>")
        assert "it was in memory" in page.document


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its fit recovers the friction that was left out, and nothing is written beside the samples."""
    shutil.copytree(SAMPLES / "rig", tmp_path / "sample_logs" / "rig")
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    mpl.use("Agg")
    with pytest.warns(swimid.SwimidWarning):
        made = runpy.run_path(str(ROOT / "docs" / "examples" / "notebook.py"))
    assert sorted(tmp_path.rglob("*")) == before
    assert made["ideal"].verdict == "bad"
    gap, drag = made["gap"], made["drag"]
    assert gap.answer == "explained"
    cause = gap.causes.iloc[0]
    assert cause["effect"] == "pulley-friction"
    friction = drag["pulley_friction"]
    both = np.hypot(cause["stderr"], friction.stderr)
    assert abs(cause["value"] - friction.value) < 3 * both


class TestNotebook:
    """What a notebook shows: figures, progress, and an error as one line."""

    LOG = SAMPLES / "rig" / "w10.csv"

    def test_a_plot_shows_its_figures(self) -> None:
        log = swimid.read_log(self.LOG)
        for drawn in (swimid.plot(log), log.plot(), swimid.plot(log.frame)):
            assert drawn._repr_html_().count("<img ") == len(drawn.figure_names) > 0

    def test_other_results_show_their_figures_too(self, drag: swimid.Fitted) -> None:
        shown = drag._repr_html_()
        assert shown.count('src="data:image/png;base64,') == len(drag.figure_names)
        assert shown.count("<details>") == len(drag.figure_names)  # the first is open; the checks are folded

    @pytest.mark.slow
    def test_series_are_xarray_too(self) -> None:
        xarray = pytest.importorskip("xarray")
        made = swimid.simulate(robot="tfish", frequency_hz=1.4, amplitude_deg=20.0, duration_s=1.0)
        log = swimid.read_log(self.LOG)
        for one in (log, swimid.load_result(self.LOG), made):
            data = one.to_xarray()
            assert isinstance(data, xarray.Dataset)
            assert list(data.dims) == ["t_s"]
            assert data["x_m"].attrs["units"] == "m"
            assert np.array_equal(data["x_m"], one.frame["x_m"])

    def test_only_public_names_are_listed(self, drag: swimid.Fitted) -> None:
        listed = set(dir(drag))
        assert {"parameters", "summary", "plot", "save", "verdict"} <= listed
        assert not {"bare", "ending", "of", "content", "file_type", "kind", "exit_status"} & listed
        assert not [name for name in listed if name.startswith("_")]

    @pytest.mark.parametrize(
        "call, text, hint",
        [
            (lambda t: swimid.fit_drag(t), "fit_drag takes trials as path or TrialSet", "swimid.load"),
            (lambda t: swimid.compare(5, params="a.yaml"), "compare takes trials as path or", "swimid.load"),
            (lambda t: swimid.read_log(t), "read_log takes path as path, not as DataFrame", "CSV or"),
            (lambda t: swimid.report([t]), "report takes inputs as sequence of", "Parameter files"),
            (lambda t: swimid.simulate(params=t), "a DataFrame holds no parameters", "parameter file"),
            (lambda t: swimid.read_robot(t), "read_robot takes name as str or path", "list_robots"),
            (lambda t: swimid.load_result(t), "load_result takes path as path", "parameter"),
        ],
    )
    def test_a_wrong_type_is_one_line_that_says_what_to_pass(self, call: Any, text: str, hint: str) -> None:
        with pytest.raises(swimid.UsageError, match=re.escape(text)) as caught:
            call(pd.DataFrame({"t_s": [0.0, 0.1], "x_m": [0.0, 0.1]}))
        assert hint in str(caught.value.hint)

    def test_a_wrong_file_or_table_is_named(self) -> None:
        with pytest.raises(swimid.InputError, match="has no 'key: value' lines at its top level"):
            swimid.fit_drag(self.LOG)
        with pytest.raises(swimid.InputError, match="log: a dict is no table"):
            swimid.plot({"x_m": [0.0, 1.0]})  # type: ignore[arg-type]
        with pytest.raises(swimid.InputError, match="log: a dict is no table"):
            swimid.Log.from_frame({"t_s": [0.0, 1.0]})  # type: ignore[arg-type]
        with pytest.raises(swimid.InputError, match="did you mean 'boxfish'"):
            swimid.load([{"log": self.LOG}], experiment="falling-weight", robot="boxfsh")

    def test_a_wrong_name_is_met_with_the_nearest(self, drag: swimid.Fitted) -> None:
        log = swimid.read_log(self.LOG)
        wrong = {
            "added_mass": lambda: drag["added_masss"],
            "x_m": lambda: log["x_mm"],
            "methods": lambda: drag.tables()["method"],
        }
        for near, call in wrong.items():
            with pytest.raises(KeyError, match=f"did you mean '{near}'"):
                call()
        with pytest.raises(swimid.UsageError, match="did you mean 'overlay-x_m'"):
            drag.plot("overlay-xm")
        with pytest.raises(AttributeError, match="did you mean 'fit_drag'"):
            _ = swimid.fit_dragg

    @pytest.mark.parametrize(
        "experiment, columns, missing",
        [
            ("falling-weight", ["x"], "x_m"),
            ("towed", ["x_m"], "force_N"),
            ("towed", ["force_N"], "x_m or u_m_s"),
            ("free-decay", ["roll"], "roll_rad"),
            ("free-swim", ["x", "y", "yaw"], "x_m"),
        ],
    )
    def test_a_table_without_a_needed_column_is_no_trial(
        self, experiment: str, columns: list[str], missing: str
    ) -> None:
        table = pd.DataFrame({"t_s": [0.0, 0.1], **dict.fromkeys(columns, 1.0)})
        with pytest.raises(swimid.InputError, match=missing):
            swimid.load([{"log": table}], experiment=experiment, robot="boxfish")

    def test_an_error_is_shown_without_its_traceback(self, capsys: pytest.CaptureFixture[str]) -> None:
        shells = pytest.importorskip("IPython.core.interactiveshell")
        shell = shells.InteractiveShell()
        shell.run_cell("import swimid; swimid.fit_drag('absent.yaml')")
        shown = capsys.readouterr()
        lines = [line for line in (shown.out + shown.err).splitlines() if line.strip()]
        assert lines == [
            "InputError: absent.yaml: cannot be read: No such file or directory", "  hint: check the path"
        ]  # fmt: skip

    def test_progress_is_shown_by_default(self, monkeypatch: pytest.MonkeyPatch) -> None:
        display = pytest.importorskip("IPython.display")
        shown: list[str] = []
        place = SimpleNamespace(update=lambda one: shown.append(one.data))
        monkeypatch.setattr(display, "display", lambda *_, **__: place)
        swimid.load_result(SAMPLES / "gap" / "params.yaml")
        swimid.report([SAMPLES / "rig" / "w10.csv"])
        assert shown == []  # no notebook
        monkeypatch.setattr("IPython.get_ipython", lambda: SimpleNamespace(kernel=1))
        swimid.report([SAMPLES / "rig" / "w10.csv"])
        assert re.match(r"drawing: <progress value=1 max=\d+></progress> 1 of \d+", shown[0])
        assert shown[-1] == ""

    def test_help_shows_the_default_of_progress(self) -> None:
        for public in (swimid.fit_drag, swimid.fit_model, swimid.diagnose):
            assert str(inspect.signature(public).parameters["progress"].default) == "automatic"
