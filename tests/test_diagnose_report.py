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
from swimid.diagnosis import figures as diagnose_figures
from swimid.diagnosis import summary as diagnose_summary
from swimid.diagnosis.diagnosed import Diagnosis
from swimid.diagnosis.figures import Drawings
from swimid.diagnosis.gap_file import GapFile, HeldOut, Value, ranked
from swimid.effects import catalogue
from swimid.effects.affected import Affected
from swimid.errors import InputError
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Model, Trial
from swimid.results import evidence as ev
from swimid.results import figures, heat
from swimid.results.report import report
from swimid.results.result import Result
from tests import gap_cases as cases
from tests.conftest import ROOT, Ran
from tests.gap_cases import replace

Run = Callable[..., Ran]
LEVELS = {
    "none": "good",
    "untold": "caution",  # that there is no gap has 30 %
    "unrepeated": "caution",  # trials differ by more than noise, by chance or not
    "repeated": "good",
    "single": "caution",  # at another setting nothing is tested
    "follows": "bad",  # validation trials are not predicted
    "explained": "good",
    "pair": "caution",  # one of its sizes ends at a bound
    "ambiguous": "caution",
    "unexplained": "bad",
    "partly": "caution",
    "reread": "good",
    "changed": "good",
    "moved": "caution",  # the parameters as given do not describe the trials
    "not given": "good",
    "black box": "bad",  # the model reproduces nothing of its output
}


def said(name: str) -> str:
    return diagnose_summary.summary(ranked(cases.ALL[name]))


def flat(text: str) -> str:
    return " ".join(text.split())


# ---------------------------------------------------------------- the terminal


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_the_summary_fits_one_screen(name: str) -> None:
    lines = said(name).split("\n")
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 100


def test_a_long_answer_is_cut_and_its_advice_kept() -> None:
    long = replace(
        cases.CURRENT,
        meaning="The water moves " + "very slowly " * 30,
        parameters={f"p{k}": cases.number(1.0 + k, 0.1, "N") for k in range(12)},
        equivalent=[f"some-other-effect-{k}" for k in range(9)],
    )
    gap = replace(cases.AMBIGUOUS, causes=[long, long, long])
    text = diagnose_summary.summary(ranked(gap))
    lines = text.split("\n")
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 100
    assert "the rest is in the gap file" in text
    assert "next     Swim at 1.0 Hz" in lines[-1]


def test_the_summary_says_what_closes_the_gap_and_by_how_much() -> None:
    text = flat(said("explained"))
    assert "servo-backlash explains it in cross-validation over trials" in text
    assert "u_m_s 14.2 % of its range, noise alone 2.1 % (71 % of the gap)" in text
    assert "servo-backlash (actuation, probability 94 %)" in text
    assert "backlash_rad 0.0351 ± 0.0021 rad (2.01°)" in text
    assert "closed u_m_s 89 % (95 %: 81 … 94 %)" in text
    assert "absorbed c_d0 0.920 ± 0.020 without, 0.710 ± 0.030 with the effect" in text
    assert "c_ma" not in text
    assert "next Swim at 1.0 Hz" in text


def test_the_summary_says_that_little_of_the_gap_closes() -> None:
    hardly = [replace(s, closed=0.4) for s in cases.BACKLASH.shrinkage]
    file = replace(cases.EXPLAINED, causes=[replace(cases.BACKLASH, shrinkage=hardly)])
    text = flat(diagnose_summary.summary(ranked(file)))
    assert "servo-backlash explains it, though less than half closes in cross-validation over trials" in text


def test_the_summary_does_not_choose_where_the_data_cannot() -> None:
    text = flat(said("ambiguous"))
    assert "these trials cannot tell current from tether or linear-drag (no gap" in text
    assert "explains" not in text
    assert "at its bound" in text


def test_the_other_verdicts_in_words() -> None:
    assert "No gap above the noise floor" in said("none")
    assert "cause" not in said("none")
    assert "do not tell whether the model has a gap" in flat(said("untold"))
    assert "nothing tells whether that is chance" in flat(said("unrepeated"))
    assert "noise and what repeats differ by" in flat(said("repeated"))
    assert "of one setting; another one is not tested" in flat(said("single"))
    follows = flat(said("follows"))
    assert "follows the trials it is fitted to, and does not predict f10a15." in follows
    assert "predicts not f10a15: 22 times the error that may be expected" in follows
    assert "gap " not in follows.split("left")[0].split("predict f10a15")[1]
    assert "servo-backlash and current together explain it" in flat(said("pair"))
    assert "no effect in the catalogue closes it" in said("unexplained")
    assert "servo-backlash closes part of it, at work or as an imitation" in flat(said("partly"))


def test_a_parameter_that_changed_is_said_first() -> None:
    text = flat(said("changed"))
    change = "k_t 0.06 → 0.0552 N·m/rad (−8 %, 71 standard errors)"
    first = f"all others unchanged, {change}, not to be told from joint-stiffness, explains it"
    assert f"EXPLAINED: The model with the parameters as given has a gap; {first}" in text
    assert "as given u_m_s 19 % of the measured range, as compare has it" in text
    assert "gap u_m_s" not in text
    result = Diagnosis("diagnose", text, {}, document=ranked(cases.ALL["changed"]))
    assert result.causes.iloc[0]["effect"] == "parameter:k_t"
    assert f"but the parameters as given are others: {change}" in flat(said("moved"))


def test_a_changed_parameter_is_written_with_its_value_in_the_file(tmp_path: Path) -> None:
    path = cases.written(tmp_path, "changed")
    assert "from: 0.06" in path.read_text()
    assert GapFile.read(path).causes[0].parameters == cases.SOFTER.parameters


def test_what_no_parameter_file_and_a_poor_black_box_leave_open_is_said() -> None:
    assert "No parameter file was given: nothing is said of its values." in flat(said("not given"))
    assert "UNEXPLAINED: The model reproduces 0.3 % of u_m_s: whether" in flat(said("black box"))


def test_a_reading_is_named_with_its_question_and_how_to_work_with_it() -> None:
    text = flat(said("reread"))
    assert "reading:drag_point=strips explains it" in text
    assert "cause reading:drag_point=strips (fluid, probability 94 %): Another answer to " in text
    assert '"Where on a link is its speed taken?": spread evenly along each link' in text
    assert "to work with it: --reading drag_point=strips" in text
    result = Diagnosis("diagnose", text, {}, document=ranked(cases.ALL["reread"]))
    row = result.causes.iloc[0]
    assert (row["effect"], row["parameter"]) == ("reading:drag_point=strips", "")
    assert row["value"] is None


def test_an_odd_trial_and_a_refuted_cause_are_told() -> None:
    odd = {"trial": "f10a15", "times": 91.0}
    file = ranked(replace(cases.UNEXPLAINED, odd_trial=odd, refuted=["waves"]))
    text = flat(diagnose_summary.summary(file))
    assert "f10a15 contradicts the other trials: no effect of all explains it." in text
    assert "odd f10a15: the others predict it 91 times worse than one another" in text
    assert "refuted waves: likeliest by the fits" in text
    failed = {c.name: c.value for c in diagnose_evidence.checks(file) if c.verdict == "fail"}
    assert failed == {
        "no trial contradicts the others": "f10a15: 91 times the others' error",
        "held-out trials bear the likeliest cause out": "waves",
    }


def test_bounds_that_are_hit_are_said_first() -> None:
    file = ranked(cases.ALL["reread"])
    body = diagnose_summary.summary(file).split("\n\n")[2]
    assert body.startswith(
        "  bounds   c_d4 at 6 and c_f0 at 0 in the refit without effects: look there first"
    )
    first = diagnose_evidence.checks(file)[0]
    assert (first.name, first.value, first.verdict) == (
        "bounds without effects",
        "c_d4 at 6 and c_f0 at 0",
        "warn",
    )
    assert not any(c.name == first.name for c in diagnose_evidence.checks(ranked(cases.EXPLAINED)))


def test_an_explanation_names_its_rivals() -> None:
    rivalled = replace(cases.BACKLASH, equivalent=["amplitude-loss"])
    text = flat(diagnose_summary.summary(ranked(replace(cases.EXPLAINED, causes=[rivalled]))))
    assert "servo-backlash (or amplitude-loss, which these trials cannot tell from it) explains it" in text
    assert "not to be told from it: amplitude-loss; together: probability 94 %" in text


@pytest.mark.parametrize(
    "without, error, with_effect, found",
    [(1.3, 0.1, 1.0, True), (1.15, 0.1, 1.0, False), (1.05, 0.01, 1.0, False), (0.7, 0.1, 1.0, True)],
)
def test_a_coefficient_moved_by_two_errors_and_a_tenth(
    without: float, error: float, with_effect: float, found: bool
) -> None:
    number = cases.number
    a = cases.absorbed("c", None, number(without, error, "1"), number(with_effect, error, "1"))
    file = ranked(replace(cases.EXPLAINED, causes=[replace(cases.BACKLASH, absorbed=[a])]))
    assert bool(diagnose_summary.moved(file)) is found


# ---------------------------------------------------------------- the report


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_every_verdict_is_rendered(tmp_path: Path, name: str) -> None:
    path = cases.written(tmp_path, name)
    for ending in ("md", "html") if name not in ("pair", "partly") else ("md",):
        page = tmp_path / f"r.{ending}"
        report(inputs=[path], output=page)
        text = page.read_text()
        assert "<script" not in text
        assert not re.search(r"[>|]\s*(nan|None|inf)\s*[<|]", text)
        assert "Gap between trials and model: tfish, free-swim" in text
        assert "Where the gap is" in text
        assert "The gap by channel" in text
        assert ("Size of the cause" in text) == any(c.parameters for c in cases.ALL[name].causes)
        assert len(text) < 3_000_000


@pytest.mark.parametrize("name", sorted(cases.ALL))
def test_the_level_follows_from_the_verdict(name: str) -> None:
    assert diagnose_evidence.verdict(ranked(cases.ALL[name])).level == LEVELS[name]


def test_a_gap_file_alone_is_shown_too(tmp_path: Path) -> None:
    path = cases.written(tmp_path, "explained")
    ev.sidecar(path).unlink()
    with pytest.warns(Warning, match="no evidence beside it"):
        report(inputs=[path], output=tmp_path / "r.html")
    assert "No evidence file" in (tmp_path / "r.html").read_text()


def test_checks_warn_of_what_weakens_an_answer() -> None:
    def verdicts(gap: GapFile) -> dict[str, str]:
        return {c.name: c.verdict for c in diagnose_evidence.checks(ranked(gap))}

    assert set(verdicts(cases.EXPLAINED).values()) == {"pass", "info"}
    assert verdicts(cases.AMBIGUOUS)["rivals"] == "warn"
    assert verdicts(cases.PARTLY)["what remains"] == "warn"
    weak = replace(cases.BACKLASH, gain=60.0)
    assert verdicts(replace(cases.EXPLAINED, causes=[weak]))["held-out gain of servo-backlash"] == "warn"
    (first, *rest) = cases.BACKLASH.extrapolation
    lost = replace(cases.BACKLASH, extrapolation=[replace(first, after=9.0), *rest])
    assert verdicts(replace(cases.EXPLAINED, causes=[lost]))["carries over to settings left out"] == "warn"
    whole = Value(value=1.0, unit="1", status="at-bound")
    bounded = replace(cases.EXPLAINED, causes=[replace(cases.BACKLASH, parameters={"gap_rad": whole})])
    assert verdicts(bounded)["sizes of the causes"] == "warn"
    assert (cases.EXPLAINED.level, bounded.level) == ("good", "caution")
    assert verdicts(cases.FOLLOWS)["validation trials are predicted"] == "warn"
    assert verdicts(cases.SINGLE)["settings"] == "warn"
    for weaker in ({"setting_count": 1}, {"unpredicted": [{"trial": "run01", "times": 3.0}]}):
        assert replace(cases.EXPLAINED, **weaker).level == "caution"
    stood_in = [
        replace(a, with_effect=replace(a.with_effect, status="at-bound")) for a in cases.BACKLASH.absorbed
    ]
    hardly = [replace(s, closed=0.4) for s in cases.BACKLASH.shrinkage]
    for more in ({"extrapolation": lost.extrapolation}, {"absorbed": stood_in}, {"shrinkage": hardly}):
        weak = replace(cases.EXPLAINED, causes=[replace(cases.BACKLASH, **more)])
        assert "warn" in verdicts(weak).values()
        assert weak.level == "caution"
    assert replace(cases.NONE, at_bound={"c_d4": 6.0}).level == "caution"


def test_logs_that_contradict_what_is_written_of_them_make_no_good_answer() -> None:
    against = ev.NoticeRecord(code="SWM063", text="the courses follow the headings mirrored")
    known = [diagnose_evidence.evidence(cases.EXPLAINED, Drawings(), notices=n) for n in ([], [against])]
    assert [e.verdict.level for e in known] == ["good", "caution"]
    assert known[1].checks[-1].verdict == "warn"


def test_the_methods_cite_what_was_done() -> None:
    made = cases.evidence(cases.EXPLAINED)
    text = " ".join(made.methods)
    for name in ("Kennedy", "Klein", "Yao", "Box"):
        assert name in text
        assert any(name in r for r in made.references)
    assert "each of 8 of 9 candidate effects" in text
    silent = cases.evidence(cases.NONE)
    assert not any("Box" in r for r in silent.references)


def test_parts_of_the_data_stand_in_their_order() -> None:
    """A diagnosis ranks them by size; a figure goes from low to high."""
    where = replace(cases.EXPLAINED.where, phase=cases.EXPLAINED.where.phase[::-1])
    gap = replace(cases.EXPLAINED, where=where)
    made = diagnose_figures.figures(gap, cases.drawings(gap))
    (figure,) = (f for f in made if f.id == "gap-parts")
    shown = {panel.title: panel.x_categories for panel in figure.panels}
    assert shown["phase"] == [c.label for c in cases.EXPLAINED.where.phase]
    assert shown["frequency"] == ["1.0 Hz", "1.4 Hz", "1.8 Hz"]
    assert shown["time"] == ["start-up", "steady"]


def test_every_figure_says_what_good_looks_like() -> None:
    for gap in cases.ALL.values():
        made = cases.evidence(gap)
        for part in (*made.figures, *made.tables):
            assert "Good:" in part.caption, part.id


# ---------------------------------------------------------------- heat maps


def _svg(drawn: ev.Heat) -> str:
    panel = ev.Panel(x_label="", y_label="ratio", heat=drawn)
    (drawing,) = figures.draw(ev.Figure(id="h", title="t", caption="c", panels=[panel]), "p-")
    return drawing.svg


def test_a_heat_map_prints_every_number_and_shades_by_size() -> None:
    drawn = _svg(ev.Heat(rows=["first", "<b>"], columns=["x", "y"], values=[[0.5, 1.0], [np.nan, 8.25]]))
    for text in ("0.5", "8.2", "–", "first", "&lt;b&gt;"):
        assert f">{text}<" in drawn, text
    assert not re.search(r"#[0-9a-f]{6}\b", drawn)
    # up to the noise nothing is shaded; the largest is darkest
    shades = [float(o) for o in re.findall(r"fill: var\(--s1\); (?:fill-)?opacity: ([\d.]+)", drawn)]
    assert shades == [heat._DARKEST]


def test_a_heat_map_shades_by_the_logarithm() -> None:
    full = heat._shade(16.0, 1.0, 16.0)
    assert heat._shade(4.0, 1.0, 16.0) == pytest.approx(full / 2)
    assert heat._shade(1.0, 1.0, 16.0) == 0.0
    assert heat._shade(0.0, 1.0, 16.0) == 0.0


def test_a_heat_map_shades_evenly() -> None:
    drawn = _svg(ev.Heat(rows=["a"], columns=["x", "y", "z"], values=[[-2.0, -1.5, 2.0]], scale="linear"))
    shades = [float(o) for o in re.findall(r"fill: var\(--s1\); (?:fill-)?opacity: ([\d.]+)", drawn)]
    # the smallest is not shaded at all; the drawing holds two decimals
    assert shades == pytest.approx([heat._DARKEST / 8, heat._DARKEST], abs=0.01)


@pytest.mark.parametrize("values", [[[1.0, 2.0]], [[1.0], [2.0]]])
def test_a_heat_map_must_fit_its_labels(values: list[list[float | None]]) -> None:
    with pytest.raises(InputError, match=r"values"):
        _svg(ev.Heat(rows=["a", "b"], columns=["x", "y"], values=values))


# ---------------------------------------------------------------- the command line


def test_the_command_hands_over_what_was_asked(
    swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, Any] = {}

    def diagnose(trials: Path, **options: Any) -> Result:
        seen.update(options, trials=trials)
        return Result("diagnose", said("explained"), {"verdict": "explained"})

    monkeypatch.setitem(sys.modules, "swimid.diagnosis.diagnose", SimpleNamespace(diagnose=diagnose))
    ran = swimid(
        "diagnose", "t.yaml", "--params", "p.yaml", "--effects", "servo-lag, current", "--effects", "waves",
        "--effect", "mine.py", "--max-causes", 2, "--jobs", 2, "--budget-s", 60, "--seed", 7,
        "--reading", "a=b", "-o", tmp_path / "gap.yaml",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    assert ran.out.startswith("tfish, free-swim")
    assert seen["effects"] == ("servo-lag", "current", "waves")
    assert seen["own_effects"] == (Path("mine.py"),)
    assert (seen["max_causes"], seen["jobs"], seen["budget_s"], seen["seed"]) == (2, 2, 60.0, 7)
    assert seen["readings"] == {"a": "b"}
    assert seen["params"] == Path("p.yaml")
    assert seen["dt"] == 0.005
    assert swimid("diagnose", "t.yaml", "--params", "p.yaml", "--json").json["result"] == {
        "verdict": "explained"
    }


def test_the_help_has_an_example(swimid: Run) -> None:
    text = swimid("diagnose", "--help").out
    assert "swimid diagnose trials.yaml --params tfish.yaml -o gap.yaml" in text
    # parameters may be left out, a trials file may not
    assert swimid("diagnose").status == 2
    assert swimid("diagnose", "t.yaml").status == 3


# ---------------------------------------------------------------- the manual


def test_the_manual_lists_the_catalogue() -> None:
    manual = (ROOT / "docs" / "diagnose.md").read_text()
    table = manual.split("## The catalogue")[1].split("## ")[0]
    stage, listed = "", {}
    for row in re.findall(r"^\| *(\w*) *\| `([a-z-]+)` \|", table, flags=re.M):
        stage = row[0] or stage
        listed[row[1]] = stage
    assert listed == {effect.name: effect.stage for effect in catalogue.catalogue()}


class Steady(Model):
    """One joint that does as it is told, with nothing behind it."""

    name = "steady"
    parameters = ()
    channels = ()
    offers = frozenset({"command"})

    def simulate(self, values: np.ndarray, trial: Trial) -> dict[str, np.ndarray]:
        return self.hooked(values, trial, Hooks())

    def hooked(self, values: np.ndarray, trial: Trial, hooks: Hooks) -> dict[str, np.ndarray]:
        angle = np.sin(trial.time_s)
        return {"angle_rad": hooks.actuated(trial.time_s, angle)}


def test_the_example_of_the_manual_works() -> None:
    """Half the amplitude is left after ln 2 over the rate; at its start value it vanishes exactly."""
    (droop,) = catalogue.from_file(ROOT / "docs" / "examples" / "effect" / "my_effect.py")
    rate = 0.1
    time = np.array([2.0, 2.0 + 1.0, 2.0 + math.log(2) / rate])
    trial = Trial("a", "fit", time, {})
    model = Steady()
    (form,) = droop.variants(model, [trial])
    affected = Affected(model, [form], [trial])
    (parameter,) = affected.parameters
    assert parameter.name == "drive-droop/rate_1_s"
    plain = model.simulate(np.array([]), trial)["angle_rad"]
    np.testing.assert_array_equal(affected.simulate(np.array([0.0]), trial)["angle_rad"], plain)
    weak = affected.simulate(np.array([rate]), trial)["angle_rad"]
    np.testing.assert_allclose(weak / plain, [1.0, math.exp(-rate), 0.5], rtol=1e-12)


class TestWhatIsStatedIsWhatIsComputed:
    def test_what_else_may_be_is_told(self) -> None:
        file = ranked(replace(cases.EXPLAINED, no_gap=0.004, outside=0.062))
        said = "no gap 0.4 %, a cause outside the catalogue 6.2 %"
        assert diagnose_summary.otherwise_text(file) == said

    @pytest.mark.parametrize(
        "held_out, said",
        [
            ("validation", "explains it on the validation trials"),
            ("trials", "explains it in cross-validation over trials"),
            ("stretches", "explains it in cross-validation over stretches of trials"),
        ],
    )
    def test_held_out_data_are_called_what_they_are(self, held_out: HeldOut, said: str) -> None:
        file = ranked(replace(cases.EXPLAINED, held_out=held_out))
        assert said in flat(diagnose_summary.summary(file))

    @pytest.mark.parametrize("name", sorted(cases.ALL))
    def test_no_report_claims_more_than_was_computed(self, name: str) -> None:
        file = ranked(cases.ALL[name])
        evidence = cases.evidence(cases.ALL[name])
        parts = evidence.model_dump(exclude={"references", "provenance"})
        text = f"{parts} {diagnose_summary.summary(file)}"
        assert not re.search("at most once in|took no part|[Ss]oftmax|threshold", text)

    def test_the_badge_says_the_verdict_and_not_that_a_gap_is_good(self) -> None:
        verdict = diagnose_evidence.verdict(ranked(cases.EXPLAINED))
        assert (verdict.level, verdict.word) == ("good", "Explained")
