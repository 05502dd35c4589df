"""A batch does each item once, keeps what is done, and says what became of the others."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import swimid as package
from swimid.errors import InputError
from tests.conftest import ROOT, SAMPLES, Ran
from tests.generators import archive
from validation import batch_runs

Run = Callable[..., Ran]

PLAN = """format: swimid-plan/1
items:
  - files: logs/*.csv
    steps:
      - rwls: {input: cmd1_rad, output: u_m_s, na: 2, nb: 1}
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a plan, three logs of which one is damaged, and the run of the plan."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "logs").mkdir()
    for number in range(2):
        archive.write_log(folder / "logs" / f"log{number}.csv", number)
    (folder / "logs" / "odd.csv").write_text("t_s,cmd1_rad,u_m_s\n0,1,2\n1,x,3\n")
    (folder / "plan.yaml").write_text(PLAN)
    package.batch(folder / "plan.yaml", output=folder / "run")
    return folder


@pytest.fixture
def lab(finished: Path, tmp_path: Path) -> Path:
    """A copy of the folder, whose run may be changed."""
    return shutil.copytree(finished, tmp_path / "lab")


def states(ran: Ran) -> dict[str, str]:
    """Return the state of each item that a run answered with ``--json``."""
    return {entry["id"]: entry["state"] for entry in ran.json["result"]["entries"]}


def stamps(run: Path) -> dict[str, int]:
    """Return when the status of each item was written."""
    return {path.parent.name: path.stat().st_mtime_ns for path in run.glob("items/*/status.json")}


def written(folder: Path, text: str) -> Path:
    """Write a plan."""
    (folder / "plan.yaml").write_text(text)
    return folder / "plan.yaml"


# ---------------------------------------------------------------- what a run leaves


def test_a_run_has_results_tables_and_a_page(lab: Path) -> None:
    run = lab / "run"
    table = pd.read_csv(run / "summary.csv", comment="#").set_index("item")
    assert dict(table.state) == {"logs_odd.csv": "refused", "logs_log0.csv": "done", "logs_log1.csv": "done"}
    assert table.index[0] == "logs_odd.csv"  # what needs attention comes first
    metrics = pd.read_csv(run / "metrics.csv", comment="#")
    a1 = metrics[metrics.quantity == "rwls: a1"]
    # The truth of the generator is -1.5; a standard error is about 0.004.
    assert (abs(a1.value + 1.5) < 0.02).all()
    assert (a1.low < a1.value).all()
    assert (a1.value < a1.high).all()
    assert package.load_result(run / "items/logs_log0.csv/rwls.yaml").verdict == "caution"
    page = (run / "index.html").read_text()
    assert "<script" not in page
    assert "http://" not in page
    assert 'id="i-logs_odd.csv"' in page
    assert "line 3" in page  # the message of the refused log


def test_a_page_of_cautions_is_not_good(lab: Path, swimid: Run) -> None:
    (lab / "logs/odd.csv").unlink()
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--collect", "--json")
    assert {entry["level"] for entry in ran.json["result"]["entries"]} == {"caution"}
    assert '<section class="banner caution">' in (lab / "run/index.html").read_text()


def test_a_result_names_its_inputs_and_command(lab: Path) -> None:
    provenance = package.load_result(lab / "run/items/logs_log0.csv/rwls.yaml").file.provenance
    assert list(provenance["inputs"]) == ["../../../logs/log0.csv"]
    assert provenance["command"].startswith("swimid rwls ../../../logs/log0.csv --input cmd1_rad")
    assert "--json" not in provenance["command"]


def test_an_item_folder_makes_a_report(lab: Path, swimid: Run) -> None:
    ran = swimid("report", lab / "run/items/logs_log0.csv", "-o", lab / "page.html")
    assert ran.status == 0, ran.err
    assert "rwls.yaml" in (lab / "page.html").read_text()


def test_a_folder_without_results_makes_no_report(lab: Path, swimid: Run) -> None:
    ran = swimid("report", lab / "logs", "-o", lab / "page.html")
    assert ran.status == 2
    assert "has no file *.evidence.json" in ran.err


# ---------------------------------------------------------------- a second run


def test_a_second_run_repeats_nothing(lab: Path, swimid: Run) -> None:
    before = stamps(lab / "run")
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--json")
    assert ran.status == 4  # one item is refused
    assert stamps(lab / "run") == before


@pytest.mark.slow
def test_a_changed_input_is_done_again(lab: Path, swimid: Run) -> None:
    before = stamps(lab / "run")
    archive.write_log(lab / "logs" / "log0.csv", 7)
    listed = swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--dry-run", "--json").json["result"]
    assert {e["id"]: e["state"] for e in listed["items"]}["logs_log0.csv"] == "outdated"
    swimid("batch", lab / "plan.yaml", "-o", lab / "run")
    after = stamps(lab / "run")
    assert [name for name in after if after[name] != before[name]] == ["logs_log0.csv"]


def test_a_touched_input_is_not_done_again(lab: Path, swimid: Run) -> None:
    before = stamps(lab / "run")
    os.utime(lab / "logs" / "log0.csv")
    swimid("batch", lab / "plan.yaml", "-o", lab / "run")
    assert stamps(lab / "run") == before


@pytest.mark.slow
def test_changed_options_leave_no_old_result(lab: Path, swimid: Run) -> None:
    plan = written(lab, PLAN.replace("nb: 1", "nb: 1, as: arx"))
    ran = swimid("batch", plan, "-o", lab / "run", "--json")
    assert states(ran)["logs_log0.csv"] == "done"
    names = {path.name for path in (lab / "run/items/logs_log0.csv").iterdir()}
    assert "arx.yaml" in names
    assert "rwls.yaml" not in names


@pytest.mark.slow
def test_results_of_another_version_are_marked_and_not_mixed_in(lab: Path, swimid: Run) -> None:
    place = lab / "run/items/logs_log0.csv/status.json"
    status = json.loads(place.read_text())
    status |= {"version": "0.0.1", "steps_sha256": "0" * 64}
    place.write_text(json.dumps(status))
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--collect", "--json")
    assert states(ran)["logs_log0.csv"] == "outdated"
    metrics = pd.read_csv(lab / "run/metrics.csv", comment="#")
    assert set(metrics.item) == {"logs_log1.csv"}
    assert "made by swimid 0.0.1" in (lab / "run/index.html").read_text()
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--json")
    assert states(ran)["logs_log0.csv"] == "done"


@pytest.mark.slow
def test_refused_items_are_tried_again_on_request(lab: Path, swimid: Run) -> None:
    before = stamps(lab / "run")
    swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--retry", "refused")
    after = stamps(lab / "run")
    assert [name for name in after if after[name] != before[name]] == ["logs_odd.csv"]


@pytest.mark.slow
def test_a_damaged_status_is_a_missing_item(lab: Path, swimid: Run) -> None:
    place = lab / "run/items/logs_log0.csv/status.json"
    place.write_bytes(place.read_bytes()[:50])
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--json")
    assert states(ran)["logs_log0.csv"] == "done"


def test_a_dry_run_writes_nothing(lab: Path, swimid: Run) -> None:
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "new", "--dry-run")
    assert ran.status == 0
    assert not (lab / "new").exists()
    assert "swimid rwls" in ran.out
    assert "3 of 3 items would be run" in ran.out


# ---------------------------------------------------------------- items that end badly

SPOILT = """format: swimid-plan/1
limits: {{time_s: {time_s}}}
items:
  - files: rig/trials.yaml
    steps: [{{diagnose: {{params: params.yaml, effect: [effect.py]}}}}]
"""


@pytest.fixture
def spoilt(tmp_path: Path, swimid: Run) -> Callable[..., dict[str, Any]]:
    """Run one item whose own effect file does something; return its status."""

    def run(code: str, *, time_s: float = 100) -> dict[str, Any]:
        shutil.copytree(SAMPLES / "rig", tmp_path / "rig")
        fit = package.fit_drag(SAMPLES / "rig/trials.yaml")
        fit.save(tmp_path / "params.yaml")
        (tmp_path / "effect.py").write_text(f"import os, signal, sys, time\n{code}\n")
        plan = written(tmp_path, SPOILT.format(time_s=time_s))
        ran = swimid("batch", plan, "-o", tmp_path / "run", "--json")
        assert ran.status == 4
        found: dict[str, Any] = json.loads((tmp_path / "run/items/rig_trials.yaml/status.json").read_text())
        return found

    return run


@pytest.mark.slow
def test_an_item_that_crashes_fails(spoilt: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    status = spoilt(
        "print('the last words', file=sys.stderr, flush=True)\nos.kill(os.getpid(), signal.SIGSEGV)"
    )
    assert status["state"] == "failed"
    assert not [*(tmp_path / "run").rglob("*.lock")]
    assert str(ROOT) not in status["error"]["log"]
    assert "SIGSEGV" in status["error"]["message"]
    assert "the last words" in status["error"]["log"]
    assert "the last words" in (tmp_path / "run/index.html").read_text()


@pytest.mark.slow
def test_an_item_beyond_its_time_fails_once(spoilt: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    place = tmp_path / "attempts"
    status = spoilt(f"open({str(place)!r}, 'a').write('x')\ntime.sleep(100)", time_s=6)
    assert place.read_text() == "x"
    assert status["state"] == "failed"
    assert "limit of 6 s" in status["error"]["message"]
    assert not [*(tmp_path / "run").rglob("*.lock")]


# ---------------------------------------------------------------- chains


@pytest.mark.slow
def test_films_of_a_day_become_one_fit(tmp_path: Path, swimid: Run) -> None:
    """Logs of one folder become a trials file, whose trials have the keys that overrides state."""
    day = tmp_path / "data" / "day1"
    day.mkdir(parents=True)
    for name in ("f10a20", "f14a20"):
        shutil.copy(SAMPLES / "tfish" / f"{name}.csv", day)
    plan = written(
        tmp_path,
        "format: swimid-plan/1\nitems:\n"
        "  - files: data/*/*.csv\n    together: true\n    steps:\n"
        "      - trials: {experiment: free-swim, robot: tfish, each: {role: fit}}\n"
        "      - fit-graybox: {max-iterations: 40, fix: {c_ma: 1.0}}\n"
        "      - compare: {channels: [x_m, yaw_rad]}\n"
        "overrides:\n"
        "  '*f10a20.csv': {trials: {drive: {frequency_hz: 1.0, amplitude_deg: 20}}}\n"
        "  '*f14a20.csv': {trials: {role: validate, drive: {frequency_hz: 1.4, amplitude_deg: 20}}}\n",
    )
    ran = swimid("batch", plan, "-o", tmp_path / "run", "--json")
    assert states(ran) == {"data_day1": "done"}, ran.out
    folder = tmp_path / "run/items/data_day1"
    comparison = package.load_result(folder / "compare.yaml")
    assert [trial["role"] for trial in comparison.data["trials"]] == ["fit", "validate"]
    fit = package.load_result(folder / "fit-graybox.yaml")
    assert fit.file.parameters["c_ma"].value == 1.0


WRONG = {
    "rwls: {input: cmd1_rad, output: u_m_s}": ("files: none/*.csv", 4, "no file matches 'none/*.csv'"),
    "rwl": ("files: logs/*.csv", 5, "there is no command 'rwl'"),
    "rwls: {inputt: cmd1_rad}": ("files: logs/*.csv", 5, "has no option 'inputt'"),
    "rwls: {na: many}": ("files: logs/*.csv", 5, "'many' is not a valid integer"),
    "rwls: {na: 99}": ("files: logs/*.csv", 5, "99 is not in the range"),
    "compare": ("files: logs/*.csv", 5, "needs 'params', and no step before it makes one"),
    "compare: {params: absent.yaml}": ("files: logs/*.csv", 5, "there is no file 'absent.yaml'"),
    "report": ("files: logs/*.csv", 5, "no step before 'report' makes a result"),
    "rwls: {as: ../x.yaml}": ("files: logs/*.csv", 5, "without a folder"),
    "batch": ("files: logs/*.csv", 5, "there is no command 'batch'"),
    "[rwls, plot]": ("files: logs/*.csv", 5, "a step is a command, or 'command: {option: value}'"),
}


@pytest.mark.parametrize("step", WRONG)
def test_a_wrong_plan_names_its_line(lab: Path, swimid: Run, step: str) -> None:
    files, line, message = WRONG[step]
    plan = written(lab, f"format: swimid-plan/1\nitems:\n  - name: x\n    {files}\n    steps: [{step}]\n")
    ran = swimid("batch", plan, "-o", lab / "new", "--json")
    assert ran.status == 3, ran.out
    error = ran.json["error"]
    assert message in error["message"]
    assert error["line"] in (line, line - 1)
    assert not (lab / "new").exists()


def test_overrides_that_match_nothing_are_an_error(lab: Path, swimid: Run) -> None:
    plan = written(lab, PLAN + "overrides:\n  logs/log9.csv: {rwls: {na: 3}}\n")
    ran = swimid("batch", plan, "-o", lab / "new")
    assert ran.status == 3
    assert "'logs/log9.csv' matches no file" in ran.err
    plan = written(lab, PLAN + "overrides:\n  logs/log1.csv: {rwl: {na: 3}}\n")
    ran = swimid("batch", plan, "-o", lab / "new")
    assert ran.status == 3
    assert "did you mean 'rwls'?" in ran.err


def test_an_override_holds_for_its_file_only(lab: Path, swimid: Run) -> None:
    plan = written(lab, PLAN + "overrides:\n  logs/log1.csv: {rwls: {na: 3}}\n")
    items = package.batch(plan, output=lab / "run", dry_run=True).data["items"]
    assert [entry["state"] for entry in items] == ["done", "outdated", "refused"]


def test_folders_and_files_that_are_left_out(lab: Path, swimid: Run) -> None:
    (lab / "frames/one").mkdir(parents=True)
    (lab / "frames/two").mkdir()
    text = "format: swimid-plan/1\nitems:\n  - {files: FILES, steps: [{track setup: {fps: 30}}]}\n"
    plan = written(lab, text.replace("FILES", "frames/*/"))
    items = package.batch(plan, output=lab / "new", dry_run=True).data["items"]
    assert [entry["id"] for entry in items] == ["frames_one", "frames_two"]
    plan = written(lab, PLAN.replace("steps:", "exclude: '*/odd.csv'\n    steps:"))
    items = package.batch(plan, output=lab / "new", dry_run=True).data["items"]
    assert [entry["id"] for entry in items] == ["logs_log0.csv", "logs_log1.csv"]


def test_two_groups_with_one_file_need_names(lab: Path, swimid: Run) -> None:
    twice = PLAN + PLAN.split("items:\n")[1]
    ran = swimid("batch", written(lab, twice), "-o", lab / "new", "--dry-run")
    assert ran.status == 3
    assert "is an item of two groups" in ran.err
    named = twice.replace("  - files", "  - name: a\n    files", 1)
    head, _, tail = named.rpartition("  - files")
    named = f"{head}  - name: b\n    files{tail}"
    ran = swimid("batch", written(lab, named), "-o", lab / "new", "--dry-run", "--json")
    assert {entry["id"] for entry in ran.json["result"]["items"]} >= {"a_logs_log0.csv", "b_logs_log0.csv"}


def test_a_folder_of_others_is_not_a_run(lab: Path, swimid: Run) -> None:
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "logs")
    assert ran.status == 2
    assert "files that do not belong to a run" in ran.err
    assert sorted(path.name for path in (lab / "logs").iterdir()) == ["log0.csv", "log1.csv", "odd.csv"]


def test_options_that_exclude_each_other(lab: Path, swimid: Run) -> None:
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--shard", "5/3")
    assert ran.status == 2
    assert "K/N with 1 <= K <= N" in ran.err
    ran = swimid("batch", lab / "plan.yaml", "-o", lab / "run", "--collect", "--dry-run")
    assert ran.status == 2


# ---------------------------------------------------------------- several processes


@pytest.mark.slow
def test_shards_do_all_items(lab: Path, swimid: Run) -> None:
    """The tasks of a job array do one shard each, and one more job collects."""
    for shard in ("1/2", "2/2"):
        assert swimid("batch", lab / "plan.yaml", "-o", lab / "new", "--shard", shard).status in (0, 4)
    assert not (lab / "new/index.html").exists()
    assert swimid("batch", lab / "plan.yaml", "-o", lab / "new", "--collect").status == 4
    table = pd.read_csv(lab / "new/summary.csv", comment="#")
    assert sorted(table.state) == ["done", "done", "refused"]


@pytest.mark.slow
def test_a_killed_run_ends_like_an_undisturbed_one(lab: Path) -> None:
    plan = lab / "plan.yaml"
    (lab / "logs/odd.csv").unlink()
    seconds = batch_runs.undisturbed(plan, lab / "one")
    assert batch_runs.killed(plan, lab / "two", kills=2, within_s=seconds) > 0
    assert batch_runs.hashes(lab / "two") == batch_runs.hashes(lab / "one")


def test_time_of_results_can_be_fixed(monkeypatch: pytest.MonkeyPatch, swimid: Run, tmp_path: Path) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    fit = package.fit_drag(SAMPLES / "rig/trials.yaml")
    assert fit.file.provenance["created"] == "2023-11-14T22:13:20+00:00"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    ran = swimid("fit-drag", SAMPLES / "rig/trials.yaml", "-o", tmp_path / "drag.yaml")
    assert ran.status == 2
    assert "SOURCE_DATE_EPOCH is 'yesterday'" in ran.err


def test_a_run_is_needed_to_compare(lab: Path, swimid: Run) -> None:
    with pytest.raises(InputError, match=r"no plan\.json"):
        package.compare_runs([lab / "logs", lab / "run"])
