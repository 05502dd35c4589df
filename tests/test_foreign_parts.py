"""Parts that several readers of other programs' files share: trees, names, units."""

from __future__ import annotations

import numpy as np
import pytest

from swimid.imports.table import in_si
from swimid.logs.units import UNITS


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
