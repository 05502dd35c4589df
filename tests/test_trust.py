"""Maps, rules and gaits: what their coefficients leave open, and when they are not to be called good."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import swimid as package
from swimid.errors import UsageError
from swimid.optimisation import optimise_gait, study
from swimid.optimisation.options import OptimiseStiffnessOptions
from swimid.optimisation.study import Performance
from swimid.results.parameters import ParameterFile
from swimid.simulation.catalogue import Applied, draw_parameters
from tests.test_best_gait import parameters

BEAT = {"amplitude_deg": 27.0, "duration_s": 6.0}
RULE = {
    **BEAT, "over": {"frequency_hz": (2.5, 3.5, 3)}, "between": (0.1, 0.8), "population": 8, "generations": 4
}  # fmt: skip


def fitted(folder: Path, errors: dict[str, float], *, converged: bool = True, drives: str = "") -> Path:
    """A parameter file of the dolphin with these standard errors, as a fit writes it."""
    path = parameters(folder, **errors)
    lines = ["fit:", "  trials: [run]", f"  converged: {str(converged).lower()}", drives]
    path.write_text(path.read_text() + "\n".join(lines) + "\n")
    return path


def checks(result: object) -> dict[str, str]:
    table = result.checks()  # type: ignore[attr-defined]
    return dict(zip(table["name"], table["verdict"], strict=True))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, package.StiffnessRule]:
    path = fitted(
        tmp_path_factory.mktemp("rule"),
        {"c_d2": 0.8},
        drives="  drives: {frequency_hz: [1.0, 3.0], amplitude_deg: [20.0, 30.0]}",
    )
    return path, package.optimise_stiffness(params=path, **RULE)


class TestRule:
    def test_it_says_where_it_extrapolates(self, made: tuple[Path, package.StiffnessRule]) -> None:
        """3.5 Hz is beyond the drives of the fit."""
        _, rule = made
        found = checks(rule)
        assert found["inside the range of the identification trials"] == "warn"
        assert found["uncertainty of the rule"] == "warn"
        assert rule.verdict == "caution"

    def test_without_errors_its_uncertainty_is_not_known(self) -> None:
        rule = package.optimise_stiffness(robot="dolphin", **RULE)
        assert checks(rule)["uncertainty of the rule"] == "info"

    def test_a_coefficient_that_is_no_stiffness_is_refused(self) -> None:
        with pytest.raises(UsageError, match="no law of a passive joint"):
            package.optimise_stiffness(robot="dolphin", coefficient="c_d2", **RULE)


@pytest.mark.slow
def test_the_goal_has_an_interval(tmp_path: Path) -> None:
    """It has the percentiles of single runs of the best gait with the same draws."""
    path = fitted(tmp_path, {"c_d2": 0.8})
    found = package.optimise_gait(
        params=path, frequency_hz=3.0, vary={"K_s": (0.1, 2.0)}, starts=1, draws=20, **BEAT
    )
    options = OptimiseStiffnessOptions.model_validate({"params": path, **RULE})
    applied = Performance.of_options(options).applied
    index = applied.model.index("c_d2")
    speeds = [
        package.simulate(
            params=path, frequency_hz=3.0, chosen={**found.at, "c_d2": float(vector[index])}, **BEAT
        ).quantities["mean_speed_m_s"].value
        for vector in draw_parameters(applied, 20, 0)[0]
    ]  # fmt: skip
    ends = np.quantile(speeds, [0.025, 0.975], method="weibull")
    # the windows' samples differ by part of an integration step
    assert found.file.best_ci95 == pytest.approx(tuple(ends), rel=2e-3)


def test_coefficients_of_a_fit_that_did_not_converge(tmp_path: Path) -> None:
    path = fitted(tmp_path, {}, converged=False)
    with pytest.warns(package.SwimidWarning, match="did not converge"):
        made = package.performance_map(params=path, over={"frequency_hz": (2.5, 3.0, 2)}, **BEAT)
    assert made.verdict != "good"
    assert checks(made)["coefficients are those of a sound fit"] == "warn"


def test_a_fit_tells_its_drives_and_a_map_heeds_them(tmp_path: Path, samples: Path) -> None:
    fitted = package.fit_graybox(samples / "tfish" / "trials.yaml", share=["c_f"])
    drives = fitted.file.fit.model_extra["drives"]
    assert drives["frequency_hz"] == [1.0, 1.8]
    assert drives["amplitude_deg"] == [20.0, 30.0]
    inside, outside = (
        package.performance_map(
            params=fitted, amplitude_deg=degrees, duration_s=6.0, over={"frequency_hz": (1.0, 1.5, 2)}
        )
        for degrees in (25.0, 40.0)
    )
    name = "inside the range of the identification trials"
    assert checks(inside)[name] == "pass"
    assert checks(outside)[name] == "warn"


def test_a_gait_that_swims_tail_first_is_bad() -> None:
    """Speed is that along the path: it does not tell which way."""
    found = package.optimise_gait(
        robot="dolphin", frequency_hz=3.0, vary={"K_s": (0.1, 2.0)}, starts=1, **BEAT
    )
    found.file.quantities["mean_surge_from_start_m_s"] = -0.1
    assert optimise_gait.make_gait_evidence(found.file, [], {}).verdict.level == "bad"
    assert study.forwards_check([0.1, None])[0].verdict == "pass"
    assert study.forwards_check([None]) == []


def test_a_slope_that_is_not_known_is_not_zero(tmp_path: Path) -> None:
    """Where a run beside the estimates diverges a quantity has no standard error, none too small."""
    path = fitted(tmp_path, {"c_d2": 0.8, "c_d1": 0.6})
    options = OptimiseStiffnessOptions.model_validate({"params": path, **RULE})
    applied: Applied = Performance.of_options(options).applied
    assert isinstance(applied.file, ParameterFile)
    centre, other, lost = [1.0], [1.1], [np.nan]
    _, whole = applied.with_errors(
        applied.values(), lambda vectors: np.array([centre, centre, other, centre, other])
    )
    _, parted = applied.with_errors(
        applied.values(), lambda vectors: np.array([centre, centre, other, centre, lost])
    )
    assert np.isfinite(whole).all()
    assert np.isnan(parted).all()
