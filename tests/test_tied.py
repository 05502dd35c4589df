"""Parameters that share one value."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swimid.errors import UsageError
from swimid.fitting.model import Model, Tied, Trial, groups_by_prefix
from tests.toy_models import FRICTION, Toy, friction, parameter

TRIAL = Trial("t", "fit", np.linspace(0, 3, 20), {})
MEMBERS = ("c_f0", "c_f13", "c_f4")


class Stepped(Toy):
    """Has something to refine."""

    def refined(self) -> Model | None:
        return Toy(self.formula, self.parameters)


def test_simulates_with_every_member_at_the_shared_value() -> None:
    model = Toy(friction, FRICTION)
    tied = Tied(model, {"c_f": MEMBERS})
    assert [p.name for p in tied.parameters] == ["thrust", "c_f"]
    there = tied.simulate(np.array([2.0, 0.7]), TRIAL)["y"]
    assert np.array_equal(there, model.simulate(np.array([2.0, 0.7, 0.7, 0.7]), TRIAL)["y"])
    ahead = tied.sensitivity_to_time(np.array([2.0, 0.7]), TRIAL)["y"]
    assert np.array_equal(ahead, model.sensitivity_to_time(np.array([2.0, 0.7, 0.7, 0.7]), TRIAL)["y"])


def test_the_shared_parameter_is_what_its_members_allow() -> None:
    parameters = (
        parameter("a1", 1.0, 0.0, 4.0, scale=1.0, free=False),
        parameter("other", 9.0),
        parameter("a2", 3.0, 1.5, 9.0, scale=3.0),
    )
    tied = Tied(Toy(lambda v, t: {"y": v[0] - v[2] + v[1] + 0 * t}, parameters), {"a": ("a1", "a2")})
    shared, other = tied.parameters
    assert (shared.name, shared.start, shared.lower, shared.upper) == ("a", 2.0, 1.5, 4.0)
    assert (shared.scale, shared.free, other.name) == (3.0, True, "other")
    assert tied.simulate(np.array([2.5, 7.0]), TRIAL)["y"] == pytest.approx(np.full(20, 7.0))


def test_the_start_is_kept_within_the_bounds() -> None:
    parameters = (parameter("a1", 0.5, 0.0, 1.0), parameter("a2", 9.0, 0.0, 9.0))
    (shared,) = Tied(Toy(friction, parameters), {"a": ("a1", "a2")}).parameters
    assert shared.start == 1.0


def test_expands_to_the_members() -> None:
    tied = Tied(Toy(friction, FRICTION), {"c_f": MEMBERS})
    found = tied.expanded({"thrust": (2.0, 0.1), "c_f": (0.3, 0.01), "c_f[t1]": (0.4, 0.02)})
    assert found["thrust"] == (2.0, 0.1)
    assert all(found[name] == (0.3, 0.01) and found[f"{name}[t1]"] == (0.4, 0.02) for name in MEMBERS)
    assert "c_f" not in found


def test_refines_what_is_inside() -> None:
    assert Tied(Toy(friction, FRICTION), {"c_f": MEMBERS}).refined() is None
    finer = Tied(Stepped(friction, FRICTION), {"c_f": MEMBERS}).refined()
    assert finer is not None
    assert [p.name for p in finer.parameters] == ["thrust", "c_f"]
    assert type(finer.model) is Toy


class TestErrors:
    model = Toy(friction, FRICTION)

    def test_unknown_member(self) -> None:
        with pytest.raises(UsageError, match="did you mean 'c_f13'"):
            Tied(self.model, {"c_f": ("c_f0", "c_f31")})

    def test_one_in_two_groups(self) -> None:
        with pytest.raises(UsageError, match="shared twice"):
            Tied(self.model, {"x": ("c_f0", "c_f13"), "y": ("c_f0", "c_f4")})

    def test_taken_name(self) -> None:
        with pytest.raises(UsageError, match="thrust is taken"):
            Tied(self.model, {"thrust": ("c_f0", "c_f13")})

    def test_a_members_own_name_is_free_to_take(self) -> None:
        assert [p.name for p in Tied(self.model, {"c_f0": MEMBERS}).parameters] == ["thrust", "c_f0"]

    def test_no_common_value(self) -> None:
        parameters = (
            FRICTION[0],
            replace(FRICTION[1], upper=0.5),
            replace(FRICTION[2], lower=1.0),
            FRICTION[3],
        )
        with pytest.raises(UsageError, match="no value"):
            Tied(Toy(friction, parameters), {"c_f": MEMBERS})

    def test_other_units(self) -> None:
        parameters = (FRICTION[0], replace(FRICTION[1], unit="kg"), *FRICTION[2:])
        with pytest.raises(UsageError, match="cannot share"):
            Tied(Toy(friction, parameters), {"c_f": MEMBERS})


class TestPrefix:
    model = Toy(friction, (*FRICTION, parameter("c_ma", 1.0), parameter("c_f", 1.0), parameter("c_fx4", 1.0)))

    def test_is_followed_by_digits(self) -> None:
        assert groups_by_prefix(self.model, "c_f") == {"c_f": MEMBERS}

    def test_unknown(self) -> None:
        with pytest.raises(UsageError, match="did you mean 'c_f'"):
            groups_by_prefix(self.model, "c_g")
        with pytest.raises(UsageError, match="as 'c_fx'"):
            groups_by_prefix(self.model, "c_fx")
