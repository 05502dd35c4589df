"""Gaps between models and recordings made by others, whose causes are known."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.conftest import ROOT, Ran
from tests.generators import real_logs
from validation.real_gaps import program
from validation.real_gaps.row import MissingDataError, Row, Sources
from validation.real_gaps.rows import roll_decay, screw_drive

Command = Callable[..., Ran]

ROWS = {row.name: row for row in program.all_rows()}


class Expected(NamedTuple):
    """What an answer stably says.

    Attributes
    ----------
    verdicts : set of str
    right : set of str
        How it compares with the known cause.
    size : float
        Largest relative error of the size. Infinite if the size is not compared.
    """

    verdicts: frozenset[str]
    right: frozenset[str]
    size: float = np.inf


NAMED = frozenset({"explained", "ambiguous", "partial"})
YES, LISTED = frozenset({"yes"}), frozenset({"yes", "listed"})
EXPECTED = {
    "double-arm-damping": Expected(NAMED, YES),
    "drive-friction": Expected(NAMED, YES, 0.3),
    "impactor-damping-0.25": Expected(NAMED, LISTED, 0.3),
    "impactor-damping-0.5": Expected(NAMED, LISTED),
    "impactor-stiffness": Expected(NAMED, LISTED, 0.05),
    "pendulum-mass": Expected(NAMED, LISTED, 0.3),
    "ramp-friction": Expected(frozenset({"explained"}), YES, 0.1),
    "roll-damping": Expected(NAMED, LISTED, 0.2),
    "single-arm-damping": Expected(NAMED, YES, 0.25),
    "spring-disc": Expected(NAMED, LISTED),
    "starfish-water": Expected(frozenset({"unexplained"}), YES),
    "tanks": Expected(frozenset({"unexplained"}), YES),
}


@pytest.fixture
def sources(real_data: Path) -> Sources:
    """The folders of recordings; ``SWIMID_REPOSITORIES`` names that of public repositories."""
    repositories = os.environ.get("SWIMID_REPOSITORIES")
    return Sources(real_data, Path(repositories) if repositories else real_data / "repositories")


def run(row: Row, sources: Sources, folder: Path) -> dict[str, Any]:
    """Result of a row; the test skips if its recordings are not here."""
    try:
        program.run_row(row, sources, folder)
    except MissingDataError as error:
        pytest.skip(f"no recording at {error}")
    return program.read_result(row, folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_known_cause_of_a_real_gap(name: str, sources: Sources, tmp_path: Path) -> None:
    """Each row whose answer is right: verdict, cause and size, held-out error of the repaired model."""
    result, expected = run(ROWS[name], sources, tmp_path), EXPECTED[name]
    assert result["verdict"] in expected.verdicts
    assert result["right"] in expected.right, result["causes"]
    if np.isfinite(expected.size):
        assert result["size"] == pytest.approx(result["known"], rel=expected.size)
    if ROWS[name].causes:
        assert result["closed"] > 0.9
        assert result["repaired"] < 0.6 * result["before"]


@pytest.mark.slow
def test_a_simulator_without_viscosity_has_its_own_damping(
    swimid: Command, sources: Sources, tmp_path: Path
) -> None:
    """Damping ratio 0.0016 and period 2.54 s, of the simulator of potential flow."""
    roll_decay.write(sources, tmp_path)
    ran = swimid("fit-drag", tmp_path / "simulator.yaml", "--fix", "quadratic_damping=0", "--json")
    derived = ran.json["result"]["derived"]
    assert derived["damping_ratio_linear"]["value"] == pytest.approx(0.0016, abs=1e-4)


@pytest.mark.slow
def test_force_of_the_drive_that_dry_friction_leaves(real_data: Path) -> None:
    """The inverse model, with nothing simulated: 17 % of the force is left without it and 4 % with it."""
    time, position, force = screw_drive.read(real_data / "emps" / "DATA_EMPS.mat")
    place, push = screw_drive.smoothed(position), screw_drive.smoothed(force)
    speed = np.gradient(place, time)
    columns = [np.gradient(speed, time), speed, np.ones_like(speed)]
    left = []
    for design in (columns, [*columns, np.sign(speed)]):
        rows = np.column_stack(design)[200:-200]
        weights = np.linalg.lstsq(rows, push[200:-200], rcond=None)[0]
        left.append(np.linalg.norm(push[200:-200] - rows @ weights) / np.linalg.norm(push[200:-200]))
    assert left[0] == pytest.approx(0.17, abs=0.01)
    assert left[1] == pytest.approx(0.04, abs=0.01)


@pytest.mark.slow
def test_a_cause_of_the_fish_reduces_held_out_errors(
    swimid: Command, real_data: Path, tmp_path: Path
) -> None:
    """Nothing is known to be missing: the amplitude that took no part in any fit judges what is named."""
    runs = real_logs.mild(real_logs.read_fish(real_data))
    robot, nominal = ROOT / "docs" / "examples" / "msu-fish.yaml", tmp_path / "fish.yaml"
    trials = real_logs.write_fish(tmp_path, runs, robot, lag_rad=real_logs.LAG_RAD, rates_only=True)
    words = ("--start-state", "estimate", "--free", "drive_phase", "--dt", "0.012")
    assert swimid("fit-graybox", trials, *words, "-o", nominal).status == 0
    ran = swimid("diagnose", trials, "--params", nominal, "--dt", "0.012", "--json")
    assert ran.status == 0, ran.err
    gap = ran.json["result"]
    if gap["verdict"] == "explained":
        rows = gap["causes"][0]["shrinkage"]
        assert np.mean([r["after"] / r["before"] for r in rows]) < 0.98


def gap_file(verdict: str, *causes: tuple[str, ...]) -> dict[str, Any]:
    """A gap file with causes of given names, of which the first is the effect itself."""
    listed = [
        {"effect": first, "equivalent": list(rest), "probability": 0.9, "parameters": {}}
        for first, *rest in causes
    ]
    errors = [
        {"label": "as given", "rmse": {"x_m": 3.0, "y_m": 1.0}},
        {"label": "refitted", "rmse": {"x_m": 2.0, "y_m": 1.0}},
        {"label": "+ cause", "rmse": {"x_m": 1.0, "y_m": 1.0}},
        {"label": "noise alone", "rmse": {"x_m": 0.5, "y_m": 0.9}},
    ]
    return {
        "verdict": verdict,
        "causes": listed,
        "waterfall": errors,
        "closed": {"share": 0.9, "by_refit": 0.5},
    }


@pytest.mark.parametrize(
    ("verdict", "causes", "right"),
    [
        ("explained", [("drag",)], "yes"),
        ("explained", [("slip", "drag")], "listed"),
        ("partial", [("drag",), ("slip",)], "partly"),
        ("ambiguous", [("slip",)], "no"),
        ("unexplained", [("drag",)], "unexplained"),
        ("none", [], "no"),
    ],
)
def test_comparison_with_the_known_cause(verdict: str, causes: list[tuple[str, ...]], right: str) -> None:
    """A cause beside 'unexplained' is no answer, and every named cause has to be acceptable."""
    row = Row("row", "", "", "", "", (), frozenset({"drag"}))
    result = program.judge(row, gap_file(verdict, *causes))
    assert result["right"] == right
    assert (result["channel"], result["before"], result["refit"]) == ("x_m", 3.0, 2.0)
    assert result["repaired"] == (1.0 if causes else None)


def test_a_gap_outside_the_catalogue_is_rightly_unexplained() -> None:
    """Of a row without acceptable names only the verdict 'unexplained' is right."""
    row = Row("row", "", "", "", "", (), frozenset())
    assert program.judge(row, gap_file("unexplained"))["right"] == "yes"
    assert program.judge(row, gap_file("none"))["right"] == "no"
    assert program.judge(row, gap_file("explained", ("drag",)))["right"] == "no"


def test_a_refused_command_is_a_row_of_the_table(tmp_path: Path) -> None:
    """The message of the command is kept, and rows without recordings have no result."""

    def write(_sources: Sources, folder: Path) -> None:
        (folder / "trials.yaml").write_text("format: swimid-trials/1\n")

    sources = Sources(tmp_path, tmp_path)
    row = Row(
        "row", "model", "all of it", "", "", (write, "diagnose trials.yaml -o gap.yaml"), frozenset({"drag"})
    )
    program.run_row(row, sources, tmp_path / "row")
    result = program.read_result(row, tmp_path / "row")
    assert result["verdict"] == result["right"] == "refused"
    assert "trials.yaml" in result["refused"]
    program.write_table(tmp_path / "table.csv", [result])
    assert "model,all of it,refused,,refused" in (tmp_path / "table.csv").read_text()


def test_rows_state_their_answer_before_they_run() -> None:
    """Names are unique, the last step is the diagnosis, and known sizes have a unit."""
    rows = list(program.all_rows())
    assert len({row.name for row in rows}) == len(rows) >= 14
    for row in rows:
        assert isinstance(row.steps[-1], str)
        assert row.steps[-1].startswith("diagnose ")
        assert row.known is None or row.known.unit
        assert row.licence
        assert row.source
