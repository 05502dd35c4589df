"""``swimid optimise gait``: searches against closed forms and scans, limits, intervals, resumption."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import swimid as package
from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.fitting.model import Array
from swimid.optimisation.optimise_gait import BestGait
from swimid.optimisation.problem import descend
from swimid.optimisation.study import Performance
from swimid.simulation.catalogue import Applied, draw_parameters
from tests.conftest import Ran, interrupting

DOLPHIN = {"robot": "dolphin", "amplitude_deg": 27.0, "duration_s": 6.0}
TABLE_3 = {
    "c_m0": 0.27, "c_m1": 0.18, "c_m2": 0.26, "c_f0": 0.039, "c_f1": 0.034, "c_f2": 0.015, "c_d0": 2.55,
    "c_d1": 4.0, "c_d2": 5.8,
}  # fmt: skip


def parameters(folder: Path, other: Mapping[str, float] | None = None, /, **stderr: float) -> Path:
    """Write a parameter file of the dolphin: published or other values, and standard errors."""
    rows = [
        f"  {name}: {{value: {value}, stderr: {stderr.get(name, 'null')}, unit: '1', status: estimated}}"
        for name, value in (TABLE_3 | dict(other or {})).items()
    ]
    head = ["format: swimid-parameters/1", "model: multilink", "robot: dolphin", "parameters:"]
    (folder / "p.yaml").write_text("\n".join([*head, *rows]) + "\n")
    return folder / "p.yaml"


def applied_to(path: Path) -> Applied:
    """Return the model with the values and errors of a parameter file."""
    given = package.optimise_gait.options.of({"params": path, "vary": {"K_s": (0.1, 1.0)}})
    found = Performance.of_options(given).applied
    assert isinstance(found, Applied)
    return found


class TestDescent:
    @pytest.mark.parametrize("seed", range(5))
    def test_quadratic_bowls(self, seed: int) -> None:
        """The bowls are rotated, with curvatures from 1 to 10."""
        rng = np.random.default_rng(seed)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix, middle = turn @ np.diag([1.0, 3.0, 10.0]) @ turn.T, rng.uniform(0.2, 0.8, 3)

        def bowl(x: Array, _owner: NDArray[np.int64]) -> Array:
            away = x - middle
            return np.einsum("ni,ij,nj->n", away, matrix, away)[:, None]

        found = descend(bowl, np.full((1, 3), 0.5), steps=60)
        assert found.points[0] == pytest.approx(middle, abs=0.01)

    def test_a_limit_that_cuts_across(self) -> None:
        """Maximise ``x + 2 y`` on a disc: the maximum is on the circle in the direction (1, 2)."""

        def parts(x: Array, _owner: NDArray[np.int64]) -> Array:
            gain = x[:, 0] + 2.0 * x[:, 1]
            return np.column_stack([-gain, 10.0 * (np.hypot(*(x - 0.5).T) / 0.3 - 1.0)])

        found = descend(parts, np.array([[0.5, 0.5], [0.1, 0.9]]), steps=60)
        expected = 0.5 + 0.3 * np.array([1.0, 2.0]) / math.sqrt(5.0)
        assert found.points == pytest.approx(np.tile(expected, (2, 1)), abs=5e-3)

    def test_minimum_on_a_face_beside_a_region_without_values(self) -> None:
        """The search goes round the region."""

        def parts(x: Array, _owner: NDArray[np.int64]) -> Array:
            value = (x[:, 0] + 0.2) ** 2 + (x[:, 1] - 0.7) ** 2
            return np.where(np.hypot(x[:, 0] - 0.5, x[:, 1]) < 0.2, np.nan, value)[:, None]

        found = descend(parts, np.array([[0.9, 0.1], [0.5, 0.1]]))
        assert found.points[np.argmin(found.values)] == pytest.approx([0.0, 0.7], abs=5e-3)

    def test_each_search_has_its_own_function(self) -> None:
        places = np.array([0.2, 0.5, 0.9])
        found = descend(lambda x, owner: ((x[:, 0] - places[owner]) ** 2)[:, None], np.full((3, 1), 0.4))
        assert found.points[:, 0] == pytest.approx(places, abs=2e-3)


def test_the_best_gait_agrees_with_a_scan() -> None:
    """The answer is within a hundredth of the range of the scan's maximum, from several starts."""
    found = package.optimise_gait(vary={"K_s": (0.1, 2.0)}, frequency_hz=3.0, **DOLPHIN)
    scan = package.performance_map(over={"K_s": (0.1, 2.0, 77)}, frequency_hz=3.0, **DOLPHIN).frame
    best = scan.loc[scan["mean_speed_m_s"].idxmax()]
    assert found.at["K_s"] == pytest.approx(best["K_s"], abs=0.03)
    assert found.file.best == pytest.approx(best["mean_speed_m_s"], rel=1e-4)
    assert sorted(found.file.ends)[-2] == pytest.approx(max(found.file.ends), rel=2e-3)
    assert found.file.inside is None


@pytest.mark.slow
def test_limits_are_kept_and_the_active_one_is_named() -> None:
    given = {**DOLPHIN, "vary": {"frequency_hz": (2.0, 4.0), "K_s": (0.1, 2.0)}}
    found = package.optimise_gait(limits={"torque_N_m": 1.2}, **given).file
    assert found.quantities["peak_torque_N_m"] <= 1.2 * 1.0011
    assert found.held_by == ["torque_N_m"]
    # a scan within the limits finds nothing faster
    scan = package.performance_map(
        over={"frequency_hz": (2.0, 4.0, 21), "K_s": (0.1, 1.0, 19)}, **DOLPHIN
    ).frame.query("peak_torque_N_m <= 1.2")
    assert found.best >= scan["mean_speed_m_s"].max() * 0.999
    with pytest.raises(NoTrustworthyResult, match="limits"):
        package.optimise_gait(limits={"torque_N_m": 0.01}, **given)


def test_the_cheapest_gait_that_is_fast_enough() -> None:
    found = package.optimise_gait(
        goal="power", reach_speed_m_s=0.5, vary={"frequency_hz": (1.5, 4.0), "K_s": (0.1, 2.0)}, **DOLPHIN
    ).file
    assert found.quantities["mean_speed_m_s"] == pytest.approx(0.5, rel=2e-3)
    assert found.held_by == ["reach_speed_m_s"]


def test_the_tightest_turn_within_a_basin() -> None:
    """The basin holds the path and the body."""
    given = {
        "robot": "tfish", "waveform": "a-cpg", "goal": "radius", "frequency_hz": 1.0, "amplitude_deg": 35.0,
        "vary": {"bias_deg": (0.0, 35.0), "asymmetry": (0.0, 0.6)}, "starts": 3,
    }  # fmt: skip
    found = package.optimise_gait(limits={"tank_m": 3.0}, **given).file
    assert found.at_bound == ["bias_deg"]
    assert found.quantities["path_extent_m"] + 0.466 <= 3.0
    assert found.verdict == "caution"


def test_draws_have_the_covariance(tmp_path: Path) -> None:
    """One of two uncertain coefficients is truncated at its bound; the others do not vary."""
    path = parameters(tmp_path, c_d1=0.3, c_f0=0.039)
    text = path.read_text() + "correlation: {names: [c_d1, c_f0], matrix: [[1.0, 0.6], [0.6, 1.0]]}\n"
    path.write_text(text)
    applied = applied_to(path)
    vectors, inside = draw_parameters(applied, 4000, 1)
    table = np.array(vectors)
    drag, friction = (table[:, applied.model.index(n)] for n in ("c_d1", "c_f0"))
    # the bound of friction, zero, is one standard error away
    assert friction.min() >= 0.0
    share = 0.5 * math.erfc(1.0 / math.sqrt(2.0))
    assert 1.0 - inside == pytest.approx(share, abs=4 * math.sqrt(share / 4000))
    assert friction.mean() == pytest.approx(0.039 * (1.0 + 0.28760), rel=0.02)
    assert np.corrcoef(drag, friction)[0, 1] == pytest.approx(0.6, abs=0.12)
    assert np.ptp(table[:, applied.model.index("c_m0")]) == 0.0


def test_draws_of_coefficients_with_large_errors(tmp_path: Path) -> None:
    """The standard errors exceed the bounds and are correlated, so that few draws are inside."""
    path = parameters(tmp_path, c_d1=300.0, c_f0=30.0)
    path.write_text(
        path.read_text() + "correlation: {names: [c_d1, c_f0], matrix: [[1.0, 0.6], [0.6, 1.0]]}\n"
    )
    applied = applied_to(path)
    vectors, inside = draw_parameters(applied, 400, 1)
    assert inside < 0.5
    model, table = applied.model, np.array(vectors)
    at = [model.index(name) for name in ("c_d1", "c_f0")]
    bounds = np.array([(model.parameters[k].lower, model.parameters[k].upper) for k in at])
    # the density on a grid over the bounds
    x, y = np.meshgrid(*(np.linspace(*ends, 401) for ends in bounds), indexing="ij")
    u, v = (x - applied.values()[at[0]]) / 300.0, (y - applied.values()[at[1]]) / 30.0
    density = np.exp(-(u * u - 2.0 * 0.6 * u * v + v * v) / (2.0 * (1.0 - 0.6**2)))
    for k, grid in zip(at, (x, y), strict=True):
        mean = float(np.average(grid, weights=density))
        sd = math.sqrt(np.average((grid - mean) ** 2, weights=density))
        assert table[:, k].mean() == pytest.approx(mean, abs=4.0 * sd / math.sqrt(400))
        assert table[:, k].std() == pytest.approx(sd, rel=4.0 / math.sqrt(800))


def test_draws_from_a_corner_of_the_bounds(tmp_path: Path) -> None:
    """Two estimates are at their lower bounds and one at its upper, so that few draws are inside."""
    path = parameters(tmp_path, c_f0=0.004, c_f1=0.004, c_f2=0.004)
    applied = applied_to(path)
    names, known = ("c_f0", "c_f1", "c_f2"), {p.name: p for p in applied.model.parameters}
    corner = {"c_f0": known["c_f0"].lower, "c_f1": known["c_f1"].lower, "c_f2": known["c_f2"].upper}
    path = parameters(tmp_path, corner, c_f0=0.004, c_f1=0.004, c_f2=0.004)
    matrix = [[1.0, 0.9, 0.9], [0.9, 1.0, 0.9], [0.9, 0.9, 1.0]]
    path.write_text(path.read_text() + f"correlation: {{names: [{', '.join(names)}], matrix: {matrix}}}\n")
    applied = applied_to(path)
    vectors, inside = draw_parameters(applied, 400, 2)
    assert inside < 0.05
    model = applied.model
    away = np.array(vectors)[:, [model.index(name) for name in names]] - np.array(list(corner.values()))
    # the density on a grid of six standard deviations into the corner
    steps = np.linspace(0.0, 6.0, 121)
    u = np.stack(np.meshgrid(steps, steps, -steps, indexing="ij"), axis=-1)
    density = np.exp(-0.5 * np.einsum("...i,ij,...j", u, np.linalg.inv(matrix), u))
    for k in range(3):
        mean = float(np.average(u[..., k], weights=density))
        sd = math.sqrt(np.average((u[..., k] - mean) ** 2, weights=density))
        assert away[:, k].mean() / 0.004 == pytest.approx(mean, abs=4.0 * sd / math.sqrt(400))
        assert away[:, k].std() / 0.004 == pytest.approx(sd, rel=4.0 / math.sqrt(400))


def test_impossible_coefficients_cannot_be_drawn(tmp_path: Path) -> None:
    """The estimate is far beyond its upper bound."""
    applied = applied_to(parameters(tmp_path, {"c_f0": 50.0}, c_f0=0.001))
    with pytest.raises(NoTrustworthyResult, match="hardly a draw"):
        draw_parameters(applied, 20, 1)


@pytest.mark.slow
def test_intervals_of_the_best_gait(tmp_path: Path) -> None:
    """The ends of the interval are the best gaits at the ends of the only uncertain coefficient."""
    given = {"amplitude_deg": 27.0, "duration_s": 4.0, "frequency_hz": 3.0, "vary": {"K_s": (0.1, 2.0)}}
    path = parameters(tmp_path, c_d2=1.2)
    found = package.optimise_gait(params=path, draws=60, starts=2, **given).file
    ends = [
        package.optimise_gait(params=path, chosen={"c_d2": 5.8 + z * 1.2}, **given).at["K_s"]
        for z in (-1.96, 1.96)
    ]
    low, high = found.at_ci95["K_s"]
    width = abs(ends[1] - ends[0])
    # the ends of an interval of 60 draws vary by a quarter of its half width
    assert sorted((low, high)) == pytest.approx(sorted(ends), abs=0.25 * width)
    assert low < found.at["K_s"] < high
    assert len(found.drawn) == found.draws == 60


def test_an_interrupted_search_continues_to_the_same_file(tmp_path: Path) -> None:
    given = {
        "params": parameters(tmp_path, c_d2=1.0), "amplitude_deg": 27.0, "duration_s": 4.0, "starts": 2,
        "frequency_hz": 3.0, "vary": {"K_s": (0.1, 2.0)}, "draws": 20,
    }  # fmt: skip
    whole, parted = tmp_path / "whole.yaml", tmp_path / "parted.yaml"
    package.optimise_gait(output=whole, **given)
    with pytest.raises(KeyboardInterrupt):
        package.optimise_gait(output=parted, progress=interrupting(8), **given)
    assert (tmp_path / "parted.yaml.partial").exists()
    package.optimise_gait(output=parted, **given)
    assert parted.read_bytes() == whole.read_bytes()


def test_the_command_writes_a_gait_file(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    out = tmp_path / "gait.yaml"
    ran = swimid(
        "optimise", "gait", "--params", parameters(tmp_path, c_d2=1.0), "--amplitude-deg", "27",
        "--vary", "frequency_hz=2,3", "--vary", "K_s=0.1,2", "--limit", "joint_rate_deg_s=450",
        "--draws", "20", "--starts", "2",
        "--duration-s", "4", "-o", out,
    )  # fmt: skip
    assert ran.status == 0
    assert "best gait" in ran.out
    found = package.load_result(out)
    assert isinstance(found, BestGait)
    assert found.file.held_by == ["joint_rate_deg_s"]
    assert found.figure_names == ["draws"]
    assert found.evidence.facts["Limits"] == "joint_rate_deg_s 7.854 rad/s"
    assert max(len(line) for line in ran.out.splitlines()) <= 100
    assert "CAUTION" in ran.out
    assert "1 of 6 checks warn: the run did not become steady" in ran.out.replace("\n", " ")


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"vary": {}}, "no parameter of the gait is varied"),
        ({"vary": {"K": (0.1, 1.0)}}, "no parameter 'K'"),
        ({"vary": {"K_s": (1.0, 0.1)}}, "not below"),
        ({"goal": "power"}, "reach_speed"),
        ({"limits": {"torque": 1.0}}, "'torque' cannot be limited"),
        ({"limits": {"torque_N_m": -1.0}}, "above zero"),
        ({"frequency_hz": None}, "the beat has no frequency_hz"),
        ({"robot": "boxfish"}, "multilink"),
    ],
)
def test_wrong_options_are_refused(changed: dict[str, object], says: str) -> None:
    given = {"vary": {"K_s": (0.1, 1.0)}, "frequency_hz": 3.0, **DOLPHIN, **changed}
    with pytest.raises((UsageError, InputError), match=says):
        package.optimise_gait(**{k: v for k, v in given.items() if v is not None})
