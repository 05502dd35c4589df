"""What a diagnosis says: on the terminal, in the report, on the command line and in the manual."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from swimid.diagnosis import evidence as diagnose_evidence
from swimid.diagnosis import verdict
from swimid.diagnosis.evidence import Diagnosis
from swimid.diagnosis.gap_file import Closed, EffectRow, GapFile, HeldOut, HypothesisRow, Value
from swimid.effects import catalogue
from swimid.fitting.model import Hooks, Model, Trial
from swimid.results import evidence as ev
from swimid.results.report import report
from swimid.results.result import Result
from tests import gap_cases as cases
from tests.conftest import ROOT, Ran
from tests.gap_cases import replace

Run = Callable[..., Ran]
LEVELS = {
    "none": "good",
    "untold": "caution",  # that there is no gap has 30 %
    "scattered": "good",
    "odd trial": "caution",  # a trial has parameters of its own
    "single": "caution",  # at another setting nothing is tested
    "follows": "bad",  # validation trials are not predicted
    "explained": "good",
    "pair": "caution",  # one of its sizes ends at a bound
    "ambiguous": "caution",
    "unexplained": "bad",
    "imitated": "caution",
    "carried": "caution",  # the error of one held-out trial falls
    "partial": "caution",  # much of the gap remains
    "reread": "good",
    "changed": "good",
    "moved": "caution",  # the parameters as given do not describe the trials
    "not given": "good",
    "black box": "bad",  # the model reproduces nothing of its output
}


def summary(gap: GapFile) -> str:
    """What the command prints of a gap, in one line."""
    return " ".join(Diagnosis.of(gap, cases.evidence(gap)).summary().split())


def said(name: str) -> str:
    return summary(cases.ALL[name])


def checked(gap: GapFile) -> dict[str, ev.Check]:
    return {check.name: check for check in cases.evidence(gap).checks}


# ---------------------------------------------------------------- the terminal


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_the_summary_fits_one_screen(name: str) -> None:
    gap = cases.ALL[name]
    lines = Diagnosis.of(gap, cases.evidence(gap)).summary().split("\n")
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 100


def test_the_summary_says_what_closes_the_gap_and_by_how_much() -> None:
    text = said("explained")
    assert "EXPLAINED: servo-backlash (backlash_rad 0.0351 ± 0.0021 rad) explains the gap." in text
    assert "In cross-validation over trials the squared error goes from 54 as given to 1.6 times" in text
    assert "99 % of the gap closes (97.1 … 99.5 %)" in text
    assert "A refit alone closes 70 %, and the cause closes 96 % of the remainder." in text
    assert "c_d0 compensated for the cause: 0.920 ± 0.020 without the cause and 0.710 ± 0.030 with" in text
    assert "c_ma" not in text
    assert "Next experiment: Swim at 1.0 Hz" in text


def test_the_first_table_has_the_errors_as_given_and_after_each_cause() -> None:
    gap, *_ = cases.evidence(cases.PAIR).tables
    assert gap.columns == ["model", "squared error over expected", "u_m_s", "yaw_rate_rad_s", "joint4_rad"]
    assert gap.rows[0] == ["as given", 54.0, "0.042 m/s", "0.13 rad/s", "0.0045 rad"]
    assert [row[0] for row in gap.rows[1:]] == ["refitted", "+ servo-backlash", "+ current", "noise alone"]


def test_the_third_table_has_the_errors_over_the_range() -> None:
    _, held, errors, causes, *others = cases.evidence(cases.EXPLAINED).tables
    assert errors.rows[0] == ["u_m_s", *(pytest.approx(v) for v in (19, 14.2, 3.4, 2.1, 96.3))]
    assert causes.rows[0][:4] == ["servo-backlash", "backlash_rad", "0.0351 ± 0.0021 rad", "94 %"]
    assert all(table.folded for table in (held, *others))


def test_the_summary_says_that_part_of_the_gap_closes() -> None:
    text = said("partial")
    assert "PARTIAL: servo-backlash (backlash_rad 0.0351 ± 0.0021 rad) closes part of the gap" in text
    assert "a cause outside the catalogue has 60 % of the probability of a gap" in text
    assert "40 % of the squared gap after a refit remains on held-out data with servo-backlash" in text


def test_a_changed_parameter_is_not_compared_with_the_refit_that_changes_it_as_well() -> None:
    text = cases.evidence(cases.CHANGED.model_copy(update={"closed": cases.EXPLAINED.closed})).verdict.text
    assert "A refit of all coefficients closes 70 %" in text
    assert "of the remainder" not in text


def test_a_cause_without_a_held_out_gap_is_no_good_answer() -> None:
    known = cases.facts("servo-backlash", held_out=cases.held_out(90.0, 91.0, 92.0, before=100.0))
    closed = Closed(before=1.0, after=0.9, share=None)
    gap = replace(cases.EXPLAINED, verdict="partial", closed=closed, facts=known)
    assert cases.evidence(gap).verdict.level == "caution"
    assert "held-out data have no gap" in summary(gap)


def test_the_summary_names_no_cause_if_the_data_cannot() -> None:
    text = said("ambiguous")
    assert "checks warn: these trials cannot distinguish current from tether or linear-drag" in text
    assert "explains" not in text
    assert "current/north_m_s at a bound" in text


def test_the_reason_why_no_cause_is_named_is_stated() -> None:
    why = "a refit of the parameters closes the gap on held-out data as well as servo-backlash"
    assert f"checks warn: {why}" in said("imitated")
    assert "warn: the held-out errors fall with servo-backlash only in f14a15" in said("carried").replace(
        "servo- ", "servo-"
    )


def test_the_other_verdicts_in_words() -> None:
    assert "NO GAP: The model describes these trials as well as their noise allows." in said("none")
    assert "cause of" not in said("none")
    assert "do not determine whether the model has a gap" in said("untold")
    assert "Trials differ in trim (0.2 of its typical size), which is part of the noise." in said("scattered")
    assert "all trials have the same setting, so that the answer is not tested at another setting" in said(
        "single"
    )
    follows = said("follows")
    assert "follows the trials it is fitted to, but not the validation trials." in follows
    assert "f10a15 has 22 times the squared error that noise and uncertain parameters explain" in follows
    assert "together explain the gap" in said("pair")
    assert "The model has a gap, and none of the effects that were tried closes the gap." in said(
        "unexplained"
    )
    assert "failed: the probability that there is no gap is only 0.1 %" in said("unexplained")


def test_a_changed_parameter_is_stated_first() -> None:
    text = said("changed")
    change = "k_t 0.06 → 0.055200 ± 0.000030 N·m/rad (71 standard errors)"
    assert f"EXPLAINED: {change} explains the gap." in text
    assert "These trials cannot distinguish parameter:k_t from joint-stiffness." in text
    assert re.search(r"as given +54\b", text)
    result = Diagnosis("diagnose", text, {}, document=cases.ALL["changed"])
    assert result.causes.iloc[0]["effect"] == "parameter:k_t"
    assert f"the given parameters differ from the refitted parameters: {change}" in said("moved")


def test_notes_of_a_missing_parameter_file_and_a_poor_black_box() -> None:
    assert "NO GAP: The refitted model describes these trials" in said("not given")
    assert "failed: the model reproduces only 0.3 % of u_m_s" in said("black box")


def test_a_reading_is_named_with_its_question_and_its_option() -> None:
    text = said("reread")
    assert "reading:drag_point=strips explains the gap" in text
    assert "To use the other reading of the robot: --reading drag_point=strips." in text
    (_, _, _, causes, *_) = cases.evidence(cases.REREAD).tables
    assert "spread evenly along each link" in str(causes.rows[0][-1])
    result = Diagnosis("diagnose", text, {}, document=cases.ALL["reread"])
    row = result.causes.iloc[0]
    assert (row["effect"], row["parameter"]) == ("reading:drag_point=strips", "")
    assert row["value"] is None


def test_an_odd_trial_is_reported() -> None:
    text = said("odd trial")
    assert (
        "trials that contradict the other trials are left out (f18a30: c_d0 1.40 ± 0.05 in place of 0.7)"
        in text
    )
    assert checked(cases.ODD)["trials agree"].verdict == "warn"
    assert "trials agree" not in checked(cases.NONE)


def test_a_refuted_cause_is_reported() -> None:
    known = cases.facts("waves", held_out=cases.held_out(1710.0, 1700.0, 1720.0))
    gap = replace(cases.UNEXPLAINED, facts=known)
    assert "held-out errors do not clearly fall with waves" in summary(gap).replace("held- ", "held-")
    failed = [c.name for c in checked(gap).values() if c.verdict == "fail"]
    assert failed == ["held-out errors fall", "structure that remains"]


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_the_verdict_follows_from_the_facts_in_the_gap_file(tmp_path: Path, name: str) -> None:
    file = GapFile.read(cases.written(tmp_path, name))
    found = verdict.decide(file.facts)
    assert (found.verdict, list(found.causes)) == (file.verdict, [c.effect for c in file.causes])


def test_bounds_that_are_reached_are_reported() -> None:
    first = checked(cases.REREAD)["bounds without effects"]
    assert (first.value, first.verdict) == ("c_d4 at 6 and c_f0 at 0", "info")
    hit = replace(cases.NONE, at_bound={"c_d4": 6.0})
    assert checked(hit)["bounds without effects"].verdict == "warn"
    assert "the refit without effects ends at bounds: c_d4 at 6" in summary(hit)
    assert first.name not in checked(cases.EXPLAINED)


def test_an_explanation_names_its_rivals() -> None:
    rivalled = replace(cases.BACKLASH, equivalent=["amplitude-loss", "tether"])
    text = summary(replace(cases.EXPLAINED, causes=[rivalled]))
    assert "servo-backlash (backlash_rad 0.0351 ± 0.0021 rad) explains the gap." in text
    assert "These trials cannot distinguish servo-backlash from amplitude-loss or tether." in text
    assert "cannot distinguish" not in summary(cases.EXPLAINED)


@pytest.mark.parametrize(
    "without, error, with_effect, found",
    [(1.3, 0.1, 1.0, True), (1.15, 0.1, 1.0, False), (1.05, 0.01, 1.0, False), (0.7, 0.1, 1.0, True)],
)
def test_a_coefficient_has_moved_beyond_two_errors_and_a_tenth(
    without: float, error: float, with_effect: float, found: bool
) -> None:
    number = cases.number
    a = cases.absorbed("c", None, number(without, error, "1"), number(with_effect, error, "1"))
    file = replace(cases.EXPLAINED, causes=[replace(cases.BACKLASH, absorbed=[a])])
    (table,) = (t for t in cases.evidence(file).tables if t.id == "coefficients")
    assert table.rows[0][-1] is found


# ---------------------------------------------------------------- the report


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_every_verdict_is_rendered(tmp_path: Path, name: str) -> None:
    path = cases.written(tmp_path, name)
    for ending in ("md", "html") if name not in ("pair", "partial") else ("md",):
        page = tmp_path / f"r.{ending}"
        report(inputs=[path], output=page)
        text = page.read_text()
        assert "<script" not in text
        assert not re.search(r"[>|]\s*(nan|None|inf)\s*[<|]", text)
        assert "Gap between trials and model: tfish, free-swim" in text
        assert "Where the gap is" in text
        assert ("Errors on held-out data" in text) == bool(cases.ALL[name].causes)
        assert ("The gap by channel" in text) == (not cases.ALL[name].causes)
        assert len(text) < 3_000_000


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_the_level_follows_from_the_verdict(name: str) -> None:
    assert cases.evidence(cases.ALL[name]).verdict.level == LEVELS[name]


def test_a_gap_file_without_evidence_is_shown(tmp_path: Path) -> None:
    path = cases.written(tmp_path, "explained")
    ev.sidecar(path).unlink()
    found = Diagnosis.load(path).content()
    assert found.verdict.level == "caution"
    assert "No evidence file" in found.verdict.text
    assert [table.id for table in found.tables][:4] == ["waterfall", "held-out", "errors", "causes"]


def test_checks_warn_of_what_weakens_an_answer() -> None:
    def verdicts(gap: GapFile) -> dict[str, str]:
        return {name: check.verdict for name, check in checked(gap).items()}

    def level(gap: GapFile) -> str:
        return cases.evidence(gap).verdict.level

    assert set(verdicts(cases.EXPLAINED).values()) == {"pass"}
    assert verdicts(cases.AMBIGUOUS)["cause against its rivals"] == "warn"
    partial = verdicts(cases.PARTIAL)
    assert (partial["cause in the catalogue"], partial["remaining gap"]) == ("warn", "warn")
    weak = replace(cases.BACKLASH, gain=60.0)
    second = replace(cases.BACKLASH, effect="waves")
    both = verdicts(replace(cases.EXPLAINED, causes=[weak, second]))
    assert both["held-out gain of servo-backlash"] == "warn"
    assert both["held-out gain of waves"] == "pass"
    whole = Value(value=1.0, unit="1", status="at-bound")
    bounded = replace(cases.EXPLAINED, causes=[replace(cases.BACKLASH, parameters={"gap_rad": whole})])
    assert verdicts(bounded)["sizes of the causes"] == "warn"
    assert (level(cases.EXPLAINED), level(bounded)) == ("good", "caution")
    assert verdicts(cases.FOLLOWS)["held-out trials"] == "fail"
    assert verdicts(cases.SINGLE)["settings"] == "warn"
    worse = cases.held_out(110.0, 90.0, 105.0, 300.0) | {
        "run01": cases.held_out(400.0, before=300.0)["f10a15"]
    }
    off = cases.facts("servo-backlash", held_out=worse)
    assert verdicts(replace(cases.EXPLAINED, facts=off))["held-out trials"] == "warn"
    stood_in = [
        replace(a, with_effect=replace(a.with_effect, status="at-bound")) for a in cases.BACKLASH.absorbed
    ]
    stood = replace(cases.EXPLAINED, causes=[replace(cases.BACKLASH, absorbed=stood_in)])
    assert verdicts(stood)["coefficients with the causes"] == "warn"
    alone = replace(cases.EXPLAINED, setting_count=1)
    for gap in (stood, alone, replace(cases.EXPLAINED, held_out="validation", facts=off)):
        assert level(gap) == "caution"
    assert level(replace(cases.NONE, at_bound={"c_d4": 6.0})) == "caution"


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_every_check_that_does_not_pass_gives_a_reason(name: str) -> None:
    for check in cases.evidence(cases.ALL[name]).checks:
        assert check.reason or check.verdict not in ("warn", "fail"), check.name


def test_logs_that_contradict_their_metadata_give_no_good_answer() -> None:
    against = ev.NoticeRecord(code="SWM063", text="the path agrees with the mirrored heading")
    known = [diagnose_evidence.build_gap_evidence(cases.EXPLAINED, notices=n) for n in ([], [against])]
    assert [e.verdict.level for e in known] == ["good", "caution"]
    assert known[1].checks[0].verdict == "warn"
    assert "mirrored heading" in known[1].verdict.text


def test_effects_with_equal_residuals_share_a_row() -> None:
    alone = {"current": [5.0, 6.0], "camera-scale": [5.0, 6.0], "wall": [5.0, 7.0]}
    gap = replace(
        cases.NONE,
        scores=[EffectRow(effect=name, probability=0.3) for name in alone],
        hypotheses=[
            HypothesisRow(effects=[], deviances=[9.0, 9.0]),
            *(HypothesisRow(effects=[name], deviances=own) for name, own in alone.items()),
        ],
    )
    (table,) = (t for t in cases.evidence(gap).tables if t.id == "scores")
    assert [(row[0], row[3]) for row in table.rows] == [("current or camera-scale", "60 %"), ("wall", "30 %")]


@pytest.mark.parametrize(
    ("name", "shown"),
    [("explained", ["as given", "refitted", "+ servo-backlash"]), ("unexplained", ["as given", "refitted"])],
)
def test_the_first_figure_has_the_squared_errors_in_turn(name: str, shown: list[str]) -> None:
    (panel,) = cases.evidence(cases.ALL[name]).figures[0].panels
    assert panel.x_categories == shown
    errors = {trace.label: trace.y for trace in panel.traces}
    assert errors["all channels"] == [54.0, 17.0, 1.6][: len(shown)]
    assert errors["surge speed"][0] == pytest.approx((0.042 / 0.0046) ** 2)
    assert [mark.at for mark in panel.marks] == [1.0]


def test_at_most_two_figures_and_the_residual_of_the_worst_trial_last() -> None:
    for gap in cases.ALL.values():
        made = cases.evidence(gap)
        assert [figure.id for figure in made.figures] == ["waterfall", "residuals"]
        labels = [trace.label for trace in made.figures[1].panels[0].traces]
        assert labels == ["refitted", "with causes"][: 2 if gap.causes else 1]
    piece = cases.worst()[1]
    without = made.figures[1].panels[1].traces[0].y
    np.testing.assert_allclose(without, np.degrees(piece.measured - piece.before))


# ---------------------------------------------------------------- the command line


def test_the_command_passes_its_options_to_the_function(
    swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, Any] = {}

    def diagnose(trials: Path, **options: Any) -> Result:
        seen.update(options, trials=trials)
        return Result("diagnose", "what is printed", {"verdict": "explained"})

    monkeypatch.setitem(sys.modules, "swimid.diagnosis.diagnose", SimpleNamespace(diagnose=diagnose))
    ran = swimid(
        "diagnose", "t.yaml", "--params", "p.yaml", "--effects", "servo-lag, current", "--effects", "waves",
        "--effect", "mine.py", "--max-causes", 2, "--jobs", 2, "--seed", 7,
        "--reading", "a=b", "-o", tmp_path / "gap.yaml",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    assert ran.out.startswith("what is printed")
    assert seen["effects"] == ("servo-lag", "current", "waves")
    assert seen["own_effects"] == (Path("mine.py"),)
    assert (seen["max_causes"], seen["jobs"], seen["seed"]) == (2, 2, 7)
    assert seen["readings"] == {"a": "b"}
    assert seen["params"] == Path("p.yaml")
    assert seen["dt"] == 0.005
    assert swimid("diagnose", "t.yaml", "--params", "p.yaml", "--json").json["result"] == {
        "verdict": "explained"
    }


# ---------------------------------------------------------------- the manual


def test_the_manual_lists_the_catalogue() -> None:
    manual = (ROOT / "docs" / "effects.md").read_text()
    table = manual.split("## The catalogue")[1].split("## ")[0]
    stage, listed = "", {}
    for row in re.findall(r"^\| *(\w*) *\| `([a-z-]+)` \|", table, flags=re.M):
        stage = row[0] or stage
        listed[row[1]] = stage
    assert listed == {effect.name: effect.stage for effect in catalogue.list_effects()}


class Steady(Model):
    """One joint that does as it is told, with nothing behind it."""

    name = "steady"
    parameters = ()
    channels = ()
    offers = frozenset({"command"})

    def simulate_hooked(self, values: np.ndarray, trial: Trial, hooks: Hooks) -> dict[str, np.ndarray]:
        angle = np.sin(trial.time_s)
        return {"angle_rad": hooks.actuate(trial.time_s, angle)}


def test_the_example_of_the_manual_works() -> None:
    """Half the amplitude is left after ln 2 over the rate; at its start value it vanishes exactly."""
    (droop,) = catalogue.from_file(ROOT / "docs" / "examples" / "effect" / "my_effect.py")
    rate = 0.1
    time = np.array([2.0, 2.0 + 1.0, 2.0 + math.log(2) / rate])
    trial = Trial("a", "fit", time, {})
    model = Steady()
    (form,) = droop.variants(model, [trial])
    affected = model.with_effects([form], [trial])
    (parameter,) = affected.parameters
    assert parameter.name == "drive-droop/rate_1_s"
    plain = model.simulate(np.array([]), trial)["angle_rad"]
    np.testing.assert_array_equal(affected.run(np.array([0.0]), trial)["angle_rad"], plain)
    weak = affected.run(np.array([rate]), trial)["angle_rad"]
    np.testing.assert_allclose(weak / plain, [1.0, math.exp(-rate), 0.5], rtol=1e-12)


class TestWhatIsStatedIsWhatIsComputed:
    def test_other_possibilities_are_stated(self) -> None:
        text = summary(
            replace(cases.EXPLAINED, facts=cases.facts("servo-backlash", no_gap=0.0004, outside=0.062))
        )
        assert "probability no gap < 0.1 %, no sign of a cause outside the catalogue" in text

    @pytest.mark.parametrize(
        "held_out, said",
        [
            ("validation", "On validation trials and in cross-validation the squared error"),
            ("trials", "In cross-validation over trials the squared error"),
            ("stretches", "In cross-validation over stretches of trials the squared error"),
        ],
    )
    def test_held_out_data_are_named_correctly(self, held_out: HeldOut, said: str) -> None:
        assert said in summary(replace(cases.EXPLAINED, held_out=held_out))
