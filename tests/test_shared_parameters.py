"""Parameters of a model that share one value in a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swimid.errors import UsageError
from swimid.fitting import output_error
from swimid.fitting.model import Trial, expand, groups_by_prefix, share
from swimid.fitting.problem import Problem
from tests.toy_models import FRICTION, Toy, friction, parameter

TRIAL = Trial("t", "fit", np.linspace(0, 3, 20), {})
MEMBERS = ("c_f0", "c_f13", "c_f4")


def test_every_member_has_the_shared_value() -> None:
    shared = share(FRICTION, {"c_f": MEMBERS})
    assert [p.name for p in shared] == ["thrust", "c_f"]
    problem = Problem(Toy(friction, FRICTION), shared, [TRIAL])
    assert problem.labels == ["thrust", "c_f"]
    assert problem.vector(np.array([2.0, 0.7]), 0).tolist() == [2.0, 0.7, 0.7, 0.7]


def test_fixed_and_own_values_take_their_places() -> None:
    own = replace(FRICTION[1], per_trial=True)
    parameters = (replace(FRICTION[0], free=False, start=9.0), own, *FRICTION[2:])
    other = replace(TRIAL, id="u", starts={"c_f0": 0.25})
    problem = Problem(Toy(friction, FRICTION), parameters, [TRIAL, other])
    assert problem.labels == ["c_f0[t]", "c_f0[u]", "c_f13", "c_f4"]
    assert problem.start[1] == 0.25
    theta = np.array([1.0, 2.0, 3.0, 4.0])
    assert [problem.vector(theta, k).tolist() for k in (0, 1)] == [[9.0, 1.0, 3.0, 4.0], [9.0, 2.0, 3.0, 4.0]]
    assert [taken.tolist() for taken in problem.taken] == [[0, 2, 3], [1, 2, 3]]


def test_a_fit_estimates_the_shared_value(rng: np.random.Generator) -> None:
    model = Toy(friction, FRICTION)
    truth = np.array([2.0, 0.7, 0.7, 0.7])
    trials = []
    for name in ("a", "b"):
        time = np.linspace(0, 3, 200)
        exact = model.simulate(truth, replace(TRIAL, time_s=time))["y"]
        trials.append(Trial(name, "fit", time, {"y": exact + 1e-3 * rng.normal(size=200)}))
    result = output_error.fit_output_error(model, trials, parameters=share(FRICTION, {"c_f": MEMBERS}))
    assert result.labels == ["thrust", "c_f"]
    assert abs(result.value("c_f") - 0.7) < 4 * (result.stderr("c_f") or 0.0)
    assert result.values("a").tolist() == [result.value("thrust"), *[result.value("c_f")] * 3]


def test_the_shared_parameter_is_what_its_members_allow() -> None:
    parameters = (
        parameter("a1", 1.0, 0.0, 4.0, scale=1.0, free=False),
        parameter("other", 9.0),
        parameter("a2", 3.0, 1.5, 9.0, scale=3.0),
    )
    shared, other = share(parameters, {"a": ("a1", "a2")})
    assert (shared.name, shared.start, shared.lower, shared.upper) == ("a", 2.0, 1.5, 4.0)
    assert (shared.scale, shared.free, other.name) == (3.0, True, "other")


def test_the_start_is_kept_within_the_bounds() -> None:
    (shared,) = share((parameter("a1", 0.5, 0.0, 1.0), parameter("a2", 9.0, 0.0, 9.0)), {"a": ("a1", "a2")})
    assert shared.start == 1.0


def test_expands_to_the_members() -> None:
    shared = share(FRICTION, {"c_f": MEMBERS})
    found = expand(shared, {"thrust": (2.0, 0.1), "c_f": (0.3, 0.01), "c_f[t1]": (0.4, 0.02)})
    assert found["thrust"] == (2.0, 0.1)
    assert all(found[name] == (0.3, 0.01) and found[f"{name}[t1]"] == (0.4, 0.02) for name in MEMBERS)
    assert "c_f" not in found


class TestErrors:
    def test_unknown_member(self) -> None:
        with pytest.raises(UsageError, match="did you mean 'c_f13'"):
            share(FRICTION, {"c_f": ("c_f0", "c_f31")})

    def test_one_in_two_groups(self) -> None:
        with pytest.raises(UsageError, match="shared twice"):
            share(FRICTION, {"x": ("c_f0", "c_f13"), "y": ("c_f0", "c_f4")})

    def test_taken_name(self) -> None:
        with pytest.raises(UsageError, match="thrust is the name of a parameter outside the group"):
            share(FRICTION, {"thrust": ("c_f0", "c_f13")})

    def test_a_members_own_name_is_free_to_take(self) -> None:
        assert [p.name for p in share(FRICTION, {"c_f0": MEMBERS})] == ["thrust", "c_f0"]

    def test_no_common_value(self) -> None:
        parameters = (
            FRICTION[0],
            replace(FRICTION[1], upper=0.5),
            replace(FRICTION[2], lower=1.0),
            FRICTION[3],
        )
        with pytest.raises(UsageError, match="no value"):
            share(parameters, {"c_f": MEMBERS})

    def test_other_units(self) -> None:
        with pytest.raises(UsageError, match="cannot share"):
            share((FRICTION[0], replace(FRICTION[1], unit="kg"), *FRICTION[2:]), {"c_f": MEMBERS})


class TestPrefix:
    parameters = (*FRICTION, parameter("c_ma", 1.0), parameter("c_f", 1.0), parameter("c_fx4", 1.0))

    def test_is_followed_by_digits(self) -> None:
        assert groups_by_prefix(self.parameters, "c_f") == {"c_f": MEMBERS}

    def test_unknown(self) -> None:
        with pytest.raises(UsageError, match="did you mean 'c_f'"):
            groups_by_prefix(self.parameters, "c_g")
        with pytest.raises(UsageError, match="a name of 'c_fx'"):
            groups_by_prefix(self.parameters, "c_fx")
