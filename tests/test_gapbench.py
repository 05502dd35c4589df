"""GapBench: what a tool sees, what it may answer, and what the table says of it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.gapbench import __main__ as gapbench
from benchmarks.gapbench import answers, labels, lisdd, make, peers, regression, scoring, sindy, table, tools
from benchmarks.gapbench.regression import Rows
from benchmarks.gapbench.tools import Tool
from tests.conftest import ROOT

ROBOTS = ["falling-weight"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cases of a rig."""
    folder = tmp_path_factory.mktemp("gapbench")
    make.make(folder, cases=2, seed=11, robots=ROBOTS)
    return folder


def answer(case: str, verdict: str, *sets: list[str], **more: Any) -> dict[str, Any]:
    """An answer; what is given beside the sets belongs to the first cause, or is the wall time."""
    wall = {"wall_s": more.pop("wall_s")} if "wall_s" in more else {}
    causes = [{"set": names, **(more if k == 0 else {})} for k, names in enumerate(sets)]
    return {"case": case, "verdict": verdict, "causes": causes, **wall}


def written(path: Path, *lines: dict[str, Any]) -> Path:
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


# ------------------------------------------------------------ make


def test_a_case_does_not_reveal_its_label(made: Path) -> None:
    assert sorted(p.name for p in (made / "cases").iterdir()) == ["0000", "0001"]
    plan = json.loads((made / "plan.json").read_text())
    for case in plan["cases"]:
        folder = made / "cases" / f"{case['number']:04d}"
        assert (folder / "trials.yaml").exists()
        seen = "".join(p.read_text() for p in folder.iterdir())
        assert not any(name in seen for name in (*case["effects"], "effect", case["kind"]))
    assert (made / "robots" / "boxfish.yaml").exists()


def test_a_label_contains_what_scoring_needs(made: Path) -> None:
    found = labels.read(made)
    plan = json.loads((made / "plan.json").read_text())["cases"]
    for case in plan:
        label = found[f"{case['number']:04d}"]
        assert (label.kind, label.effects) == (case["kind"], tuple(case["effects"]))
        assert label.gap is not None
        assert label.gap >= 1.0
        assert 0.0 < label.floor["x_m"] < 0.1


def test_existing_cases_are_kept_and_never_mixed(made: Path) -> None:
    log = next((made / "cases" / "0000").glob("run*.csv"))
    before = log.stat().st_mtime_ns
    assert make.make(made, cases=2, seed=11, robots=ROBOTS) == 2
    assert log.stat().st_mtime_ns == before
    with pytest.raises(SystemExit, match="another plan"):
        make.make(made, cases=2, seed=12, robots=ROBOTS)


def test_without_recordings_there_is_a_notice(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("SWIMID_DATA", raising=False)
    assert make.plan_real(3) == []
    assert "SWIMID_DATA is unset" in capsys.readouterr().err


@pytest.mark.slow
def test_a_recording_becomes_a_case(real_data: Path, tmp_path: Path) -> None:
    plan = {case["robot"]: case for case in make.real.plan(real_data, 7)}
    assert {case["kind"] for case in plan.values()} == {"real"}
    label = tmp_path / "labels" / "0007.json"
    make.real.write(plan["ship"], tmp_path / "cases" / "0007", label, real_data)
    files = {path.name for path in (tmp_path / "cases" / "0007").iterdir()}
    assert files == {"trials.yaml", "basin.csv", "ship.yaml", "params_prior.yaml"}
    assert labels.read(tmp_path)["0007"].effects == ("linear-drag", "quadratic-drag")


# ------------------------------------------------------------ answers


@pytest.mark.parametrize(
    "line, said",
    [
        ('{"case": "0001", "verdict": "maybe"}', "verdict: Input should be 'none'"),
        ('{"case": "7", "verdict": "none"}', "case: String should match"),
        ('{"case": "0001", "verdict": "none", "cause": []}', "cause: Extra inputs are not permitted"),
        ('{"case": "0001", "verdict": "explained"}', "the verdict 'explained' names no cause"),
        ('{"case": "0001", "verdict": "none", "causes": [{"set": ["wall"]}]}', "'none' has no causes"),
        ('{"case": "0001", "verdict": "explained", "causes": [{"set": []}]}', "causes.0.set: List should"),
        (
            '{"case": "0001", "verdict": "explained", "causes": [{"set": ["wall"], "probability": 1.2}]}',
            "causes.0.probability: Input should be less than or equal to 1",
        ),
        (
            '{"case": "0001", "verdict": "explained", "causes": [{"set": ["wall", "wall"]}]}',
            "an effect stands in the set twice",
        ),
        (
            '{"case": "0001", "verdict": "explained", "causes": [{"set": ["wall"], '
            '"closed": {"x_m": [0.8, [0.9, 0.7]]}}]}',
            "the interval of 0.8 ends before it begins",
        ),
        ('{"case": "0000", "verdict": "none"}', "case 0000 is answered twice"),
        ("{", "Invalid JSON"),
    ],
)
def test_a_bad_answer_is_refused_with_its_line(tmp_path: Path, line: str, said: str) -> None:
    path = tmp_path / "tool.jsonl"
    path.write_text('{"case": "0000", "verdict": "none"}\n\n' + line + "\n")
    with pytest.raises(answers.BadAnswer) as caught:
        answers.read(path)
    assert str(caught.value).startswith(f"{path}:3: ")
    assert said in str(caught.value)


def test_an_answer_of_no_case_is_refused(made: Path, tmp_path: Path) -> None:
    path = written(tmp_path / "tool.jsonl", answer("0000", "none"), answer("0044", "none"))
    with pytest.raises(SystemExit, match=r"tool\.jsonl:2: the benchmark has no case 0044"):
        gapbench.main(["score", str(made), str(path)])


def test_the_documented_answer_is_one() -> None:
    text = (ROOT / "docs" / "gapbench.md").read_text()
    (line,) = [line for line in text.splitlines() if line.startswith('{"case"')]
    assert answers.Answer.model_validate_json(line).causes[0].set == ["servo-lag", "servo-delay"]


def test_a_gap_file_becomes_an_answer() -> None:
    gap = {
        "verdict": "ambiguous",
        "where": {"channels": [{"channel": "x_m", "nrmse": 0.1, "rmse": 0.2}]},
        "causes": [
            {
                "effect": "wall", "probability": 0.6, "equivalent": ["tether", "reading:drag_point=strips"],
                "shrinkage": [
                    {"channel": "x_m", "shipped": 0.1, "after": 0.04, "closed": 0.7, "ci95": [0.6, 0.8]},
                    {"channel": "y_m", "shipped": 0.1, "after": 0.04, "closed": None, "ci95": None},
                ],
            }
        ],
    }  # fmt: skip
    found = answers.of_gap("0003", gap, 2.0)
    (cause,) = found.causes
    assert cause.set == ["wall", "tether", "reading:drag_point=strips"]
    assert cause.closed == {"x_m": (0.7, (0.6, 0.8))}
    # the range is 2 m
    assert cause.errors["x_m"] == pytest.approx((0.2, 0.08))
    assert answers.Answer.model_validate_json(found.line()) == found


# ------------------------------------------------------------ answer

FAKE = """
import json, sys
from pathlib import Path
import swimid
assert not any((p / "labels").exists() for p in Path.cwd().parents), "labels are near"
output = Path(sys.argv[sys.argv.index("-o") + 1])
if sys.argv[1] == "diagnose":
    cause = {"effect": swimid.NAME, "probability": 0.5}
    output.write_text(json.dumps({"verdict": "explained", "where": {"channels": []}, "causes": [cause]}))
else:
    output.write_text("parameters")
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Another checkout, whose program answers one thing."""
    package = tmp_path / "old" / "swimid"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text('NAME = "wall"\n')
    (package / "__main__.py").write_text(FAKE)
    return package.parent


def test_answers_come_from_the_checkout_asked_for(made: Path, tmp_path: Path, checkout: Path) -> None:
    out = tmp_path / "old.jsonl"
    words = ["--tool", "checkout", "--checkout", str(checkout), "--cases", str(made / "cases")]
    gapbench.main(["answer", *words, "--only", "0001", "--out", str(out)])
    (found,) = answers.read(out).values()
    assert (found.case, found.verdict, found.causes[0].set) == ("0001", "explained", ["wall"])
    gapbench.main(["answer", *words, "--out", str(out), "--jobs", "2"])
    assert set(answers.read(out)) == {"0000", "0001"}


def test_answered_cases_are_not_asked_again(made: Path, tmp_path: Path) -> None:
    """A line that was cut when the program was killed is, a whole one without its end is not."""
    out = tmp_path / "tool.jsonl"
    first = json.dumps(answer("0000", "none"))
    failing = Tool((sys.executable, "-c", "raise SystemExit(3)"), ROOT)
    out.write_text(first + "\n" + json.dumps(answer("0001", "none"))[:20])
    assert tools.answer_all(failing, made / "cases", out) == 1
    found = answers.read(out)
    assert (found["0000"].verdict, found["0001"].verdict) == ("none", "failed")
    out.write_text(out.read_text().rstrip("\n"))
    assert tools.answer_all(failing, made / "cases", out) == 0


def test_a_case_that_is_not_there_is_refused(made: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no case 0009"):
        tools.answer_all(tools.tool("swimid"), made / "cases", tmp_path / "a.jsonl", only=["0009"])


# ------------------------------------------------------------ peers


def test_the_least_bic_decides() -> None:
    rounds = [{"": 100.0, "wall": 60.0, "tether": 64.0, "waves": 90.0}, {"": 60.0, "waves": 61.0}]
    found = peers.verdict(rounds)
    assert found["verdict"] == "ambiguous"
    (cause,) = found["causes"]
    assert (cause["effect"], cause["equivalent"]) == ("wall", ["tether"])
    assert cause["probability"] == pytest.approx(1.0, abs=1e-6)
    assert peers.verdict([{"": 10.0, "wall": 12.0}]) == {
        "verdict": "none", "causes": [], "where": {"channels": []},
    }  # fmt: skip


def test_the_regression_finds_a_force_in_a_motion() -> None:
    """``y'' = -0.4 y' - 3 y' |y'|`` of one equation: the linear term lowers the BIC, a constant does not."""
    rng = np.random.default_rng(2)
    v = rng.uniform(-1.0, 1.0, 300)
    left = (-0.4 * v - 3.0 * v * np.abs(v) + 0.05 * rng.normal(size=300))[:, None]
    base = (v * np.abs(v))[:, None, None]
    plain = regression.compute_bic(base, left)
    assert regression.compute_bic(np.concatenate([base, v[:, None, None]], axis=2), left) < plain - 100.0
    assert regression.compute_bic(np.concatenate([base, np.ones((300, 1, 1))], axis=2), left) > plain - 6.0


def motion(coefficient: float, where: float = 0.0) -> Rows:
    """``y'' = -3 y' |y'| + coefficient y'`` at speeds above ``where``, with a library of two terms."""
    rng = np.random.default_rng(4)
    v = rng.uniform(-1.0, 1.0, 600)
    square = v * np.abs(v)
    left = -3.0 * square + coefficient * v * (np.abs(v) > where) + 0.05 * rng.normal(size=600)
    effects = {"linear-drag": v, "pulley-viscous": v, "tether": rng.normal(size=600)}
    terms = {name: term[:, None, None] for name, term in effects.items()}
    return Rows(left[:, None], square[:, None, None], terms, np.abs(v))


@pytest.mark.parametrize("discover, where", [(sindy.discover, 0.0), (lisdd.discover, 0.5)])
def test_a_discovery_names_the_force_of_a_motion(discover: Any, where: float) -> None:
    found = discover(motion(-0.4, where))
    assert found["verdict"] == "ambiguous"
    assert found["causes"] == [{"effect": "linear-drag", "equivalent": ["pulley-viscous"]}]
    assert discover(motion(0.0))["verdict"] == "none"


def test_a_discrepancy_without_a_term_is_unexplained() -> None:
    rows = motion(0.0)
    disturbed = rows.left + 0.5 * np.cos(40.0 * rows.speed)[:, None] * (rows.speed > 0.5)[:, None]
    found = lisdd.discover(rows._replace(left=disturbed))
    assert (found["verdict"], found["causes"]) == ("unexplained", [])


@pytest.mark.slow
@pytest.mark.parametrize("name", tools.PEERS)
def test_every_peer_answers_a_case(made: Path, tmp_path: Path, name: str) -> None:
    case, path = made / "cases" / "0001", tmp_path / "gap.yaml"
    words = [str(case / "trials.yaml"), "--params", str(case / "params_prior.yaml"), "-o", str(path)]
    words += ["--jobs", "1", "--no-progress"]
    peers.main([name, "diagnose", *words])
    found = answers.of_gap("0001", json.loads(path.read_text()), 1.0)
    assert answers.Answer.model_validate_json(found.line()).verdict != "failed"


# ------------------------------------------------------------ score

LABELS = [
    {"kind": "clean", "effects": [], "gap": 1.0},
    {"kind": "single", "effects": ["wall"], "gap": 4.0, "floor": {"x_m": 0.02}},
    {"kind": "single", "effects": ["tether"], "gap": 3.0, "floor": {"x_m": 0.02}},
    {"kind": "single", "effects": ["waves"], "gap": 2.0},
    {"kind": "single", "effects": ["waves"], "gap": 1.2},
    {"kind": "pair", "effects": ["wall", "waves"], "gap": 5.0},
    {"kind": "pair", "effects": ["wall", "waves"], "gap": 5.0},
    {"kind": "outside", "effects": ["gusts"], "gap": 2.0},
    {"kind": "outside", "effects": ["gusts"], "gap": 1.1},
    {"kind": "real", "effects": ["linear-drag", "quadratic-drag"], "gap": None},
    {"kind": "real", "effects": [], "gap": None},
]
ANSWERS = [
    answer("0000", "explained", ["waves"], probability=0.6, wall_s=1.0),
    # with the true noise (0.2**2 - 0.05**2) / (0.2**2 - 0.02**2) = 0.947
    answer(
        "0001", "explained", ["wall"], ["current"], probability=0.9, wall_s=2.0,
        closed={"x_m": [0.93, [0.9, 0.97]]}, errors={"x_m": [0.2, 0.05]},
    ),
    # and (0.1**2 - 0.02**2) / (0.1**2 - 0.02**2) = 1
    answer(
        "0002", "ambiguous", ["current", "tether", "wall"], probability=0.85, wall_s=3.0,
        closed={"x_m": [0.8, [0.7, 0.9]]}, errors={"x_m": [0.1, 0.02]},
    ),
    answer("0003", "ambiguous", ["wall", "tether", "current", "waves"], probability=1.0, wall_s=4.0),
    answer("0004", "explained", ["wall"], probability=0.4, wall_s=5.0),
    answer("0005", "explained", ["wall", "tether"], ["waves"], probability=0.9, wall_s=6.0),
    answer("0006", "explained", ["wall", "waves"], probability=0.9, wall_s=7.0),
    answer("0007", "unexplained", ["wall"], wall_s=8.0),
    answer("0009", "ambiguous", ["quadratic-drag", "pulley-friction"], probability=0.7),
    answer("0010", "none"),
]  # fmt: skip


@pytest.fixture
def judged(tmp_path: Path) -> tuple[Path, Path]:
    """A benchmark of labels alone, and answers to all of it but for one case."""
    (tmp_path / "labels").mkdir()
    for number, label in enumerate(LABELS):
        path = tmp_path / "labels" / f"{number:04d}.json"
        path.write_text(json.dumps({"robot": f"robot{number}", **label}))
    return tmp_path, written(tmp_path / "tool.jsonl", *ANSWERS)


def test_scores_agree_with_a_count_by_hand(judged: tuple[Path, Path]) -> None:
    found = dict(scoring.figures(scoring.scored(*judged)))
    begins = {
        "cases answered": "8 of 9",
        "one effect, gap 3 x or more: true cause in the set": "2 of 2",
        "one effect, gap 1.5 to 3 x: the same": "0 of 1",
        "one effect, any gap: only others named": "1 of 4",
        "nothing hidden: a cause named": "1 of 1",
        "outside the catalogue, gap 1.5 x or more: `unexplained` or `partial`": "1 of 1",
        "the same: a cause named": "0 of 1",
        "two effects: both named": "1 of 2",
        "one effect, a cause named: a second one made up": "1 of 4",
        "closed share within 5 points": "1 of 2",
        "true closed share in its 95 % interval": "1 of 2",
        "stated probability 0 to 0.5, mean: cause in the set": "0.40: 0 of 1",
        "stated probability 0.5 to 0.8, mean: cause in the set": "0.60: 0 of 1",
        "stated probability 0.8 to 0.95, mean: cause in the set": "0.89: 4 of 4",
        "stated probability 0.95 to 1, mean: cause in the set": "1.00: 1 of 1",
        "one effect, gap 3 x or more: mean size of the set": "2.00 (of 2)",
        "wall time, median": "4.5 s",
        # between the seventh and the eighth of eight
        "wall time, 90 % quantile": "7.3 s",
    }
    assert list(found) == list(begins)
    assert [text for name, text in found.items() if not text.startswith(begins[name])] == []


def test_only_what_every_entry_answers_may_be_compared(judged: tuple[Path, Path], tmp_path: Path) -> None:
    bench, whole = judged
    first = whole.read_text(encoding="utf-8").splitlines()[0]
    few = tmp_path / "few.jsonl"
    few.write_text(f"{first}\n", encoding="utf-8")
    entries = {path.stem: scoring.scored(bench, path) for path in (whole, few)}
    found = scoring.common(entries)
    assert [[r.answer.case for r in rows] for rows in found.values()] == [["0000"], ["0000"]]


def test_shares_have_wilsons_interval() -> None:
    """Of 8 in 10: (0.8 + z²/20 ± z sqrt(0.016 + z²/400)) / (1 + z²/10) with z = 1.96."""
    assert scoring.share(8, 10) == "8 of 10, 80 % [49, 94]"
    assert scoring.share(0, 0) == "–"


def test_the_table_has_one_column_for_each_entry(judged: tuple[Path, Path]) -> None:
    folder, path = judged
    none = written(folder / "silent.jsonl")
    entries = {p.stem: scoring.scored(folder, p) for p in (path, none)}
    text = table.markdown(entries)
    assert "| figure | tool | silent |" in text
    assert "| cases answered | 8 of 9, 89 % [57, 98] | 0 of 9, 0 % [0, 30] |" in text
    right = "right: ambiguous quadratic-drag/pulley-friction"
    assert f"| robot9 | linear-drag, quadratic-drag | {right} | wrong: failed |" in text
    assert "| robot10 | none | wrong: none | wrong: failed |" in text
