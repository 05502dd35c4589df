"""Parts that several readers of other programs' files share: trees, names, units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swimid.errors import InputError
from swimid.imports.table import ForeignTable, choose, flat, in_si, length, of_records, of_tree
from swimid.logs.units import UNITS

TIME = np.arange(5.0)
TREE = {
    "run": {"t": TIME, "acc": np.arange(15.0).reshape(5, 3), "row": TIME[None], "note": " calm "},
    "rate": np.array([[50.0]]),
    "wide": np.arange(10.0).reshape(2, 5),
    "list": [TIME, 2.0],
    "cube": np.zeros((2, 2, 2)),
    "empty": np.zeros(0),
    "blank": "  ",
}


def read(select: str | None, content: Any = TREE) -> ForeignTable:
    return of_tree(content, select, Path("a.mat"), lambda value: value)


def test_columns_of_a_tree() -> None:
    """Arrays of the usual length are columns; matrices have one column for each of theirs."""
    table = read(None)
    assert list(table.columns) == [
        "run.t", "run.acc[1]", "run.acc[2]", "run.acc[3]", "run.row", "wide[1]", "wide[2]", "list{1}",
    ]  # fmt: skip
    np.testing.assert_array_equal(table.columns["run.acc[2]"], np.arange(15.0).reshape(5, 3)[:, 1])
    np.testing.assert_array_equal(table.columns["run.row"], TIME)
    np.testing.assert_array_equal(table.columns["wide[2]"], np.arange(5.0, 10.0))
    assert table.scalars == {"rate": 50.0, "list{2}": 2.0}
    assert table.metadata == {"run.note": "calm"}


@pytest.mark.parametrize("select", ["run.acc", "run/acc"])
def test_a_group_or_one_array_of_a_tree(select: str) -> None:
    assert list(read("run").columns) == ["t", "acc[1]", "acc[2]", "acc[3]", "row"]
    assert list(read(select).columns) == ["acc[1]", "acc[2]", "acc[3]"]


@pytest.mark.parametrize(
    ("select", "words"),
    [("walk", "holds no struct or group 'walk'"), ("run.t.x", "holds no struct or group 'run.t.x'")],
)
def test_a_group_that_is_not_there(select: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(select)


def test_one_of_several_is_chosen() -> None:
    path = Path("a.mat")
    assert choose(None, ["hip"], "body", path) == "hip"
    assert choose("tail", ["hip", "tail"], "body", path) == "tail"
    with pytest.raises(InputError, match="holds 2 bodies; name one"):
        choose(None, ["hip", "tail"], "body", path)
    with pytest.raises(InputError, match="holds no body 'tial'"):
        choose("tial", ["hip", "tail"], "body", path)


@pytest.mark.parametrize(
    ("name", "unit", "found", "factor"),
    [
        ("Speed", "km/h", "Speed_m_s", 1 / 3.6),
        ("Speed", "kn", "Speed_m_s", 1852 / 3600),
        ("Speed", "mm/s", "Speed_m_s", 1e-3),
        ("Fx", "kN", "Fx_N", 1e3),
        ("depth", "cm", "depth_m", 0.01),
        ("depth", "ft", "depth_m", 0.3048),
        ("angle", "deg", "angle_rad", np.pi / 180),
        ("rate", "deg/s", "rate_rad_s", np.pi / 180),
        ("note", "furlong", "note", 1.0),
        ("t_s", "ms", "t_s", 1e-3),
        ("x_m", "mm", "x_m", 1e-3),
        ("x_m", "N", "x_m", 1.0),
    ],
)
def test_units_become_those_of_a_log(name: str, unit: str, found: str, factor: float) -> None:
    column, values = in_si(name, unit, np.array([2.0, -3.0]))
    assert column == found
    np.testing.assert_allclose(values, factor * np.array([2.0, -3.0]), rtol=1e-9)


#: Prefixes, and units by their definitions in SI units: BIPM (2019), the yard agreement of 1959. A servo's
#: encoder has 4096 ticks per rotation.
PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "h": 1e2, "k": 1e3}
DEFINED = {
    **dict.fromkeys(("s", "m", "N", "Pa", "T", "V", "A", "W", "Hz", "rad", "px", "degC"), 1.0),
    "min": 60.0, "h": 3600.0, "in": 0.0254, "ft": 12 * 0.0254, "kn": 1852 / 3600, "bar": 1e5, "G": 1e-4,
    "deg": np.pi / 180, "rev": 2 * np.pi, "tick": 2 * np.pi / 4096, "gf": 9.80665e-3,
    "lbf": 0.45359237 * 9.80665,
}  # fmt: skip
#: Units that mean another thing for another quantity.
OWN = {
    ("acceleration", "g"): 9.80665, ("mass", "g"): 1e-3, ("turn rate", "rpm"): 2 * np.pi / 60,
    ("frequency", "rpm"): 1 / 60,
}  # fmt: skip


def defined(quantity: str, unit: str) -> float:
    """Return a unit in SI units, from its prefixes, products and powers."""
    top, _, below = unit.partition("/")
    if below:
        power = 2 if below.endswith("2") else 1
        return defined(quantity, top) / defined(quantity, below.removesuffix("2")) ** power
    known = OWN.get((quantity, unit), DEFINED.get(unit))
    if known is not None:
        return known
    if quantity == "torque":
        force, arm = unit.split("N")
        return PREFIXES.get(force, 1.0) * defined("length", arm)
    return PREFIXES[unit[0]] * defined(quantity, unit[1:])


@pytest.mark.parametrize("quantity", UNITS)
def test_every_unit_has_its_definition(quantity: str) -> None:
    for unit, factor in UNITS[quantity].items():
        assert factor == pytest.approx(defined(quantity, unit), rel=1e-12), unit
    assert next(iter(UNITS[quantity].values())) == 1


@pytest.mark.parametrize(
    ("unit", "factor", "name"), [("mm", 1e-3, "m"), ("inch", 0.0254, "m"), ("px", 1.0, "px")]
)
def test_a_unit_of_length(unit: str, factor: float, name: str) -> None:
    assert length(unit, Path("a.csv")) == (pytest.approx(factor), name)


@pytest.mark.parametrize(
    ("unit", "words"), [(None, "states no unit"), ("", "states no unit"), ("kg", "no unit of")]
)
def test_no_unit_of_length(unit: str | None, words: str) -> None:
    with pytest.raises(InputError, match=words):
        length(unit, Path("a.csv"))


def test_records_become_columns() -> None:
    found = of_records([{"a": 1, "b": "x"}, {"a": 2**70, "c": 2.5}])
    np.testing.assert_allclose(found["a"], [1.0, 2.0**70])
    np.testing.assert_array_equal(np.isnan(found["c"]), [True, False])
    assert found["b"][0] == "x"
    nested = flat({"a": {"b": [1, [2, 3]]}, "long": list(range(10_000))})
    assert dict(nested) == {"a.b[1]": 1, "a.b[2][1]": 2, "a.b[2][2]": 3}
