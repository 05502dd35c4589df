"""Units of the columns of a log, and names of columns."""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable
from itertools import chain, count

from swimid.errors import (
    suggestion,
)

_G = 9.80665  # standard gravity, m/s², ISO 80000-3
_DEG, _REV, _RPM = math.pi / 180, 2 * math.pi, 2 * math.pi / 60

#: Factor from each unit to the SI unit, by quantity and name of the unit. The first unit of a quantity is the
#: SI unit.
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60, "h": 3600},
    "pixels": {"px": 1},
    "pixel speed": {"px/s": 1},
    "pixel acceleration": {"px/s2": 1},
    "length": {"m": 1, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "km": 1e3, "in": 0.0254, "ft": 0.3048},
    "angle": {"rad": 1, "deg": _DEG, "mrad": 1e-3, "rev": _REV, "cdeg": _DEG / 100, "tick": _REV / 4096},
    "speed": {"m/s": 1, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1 / 3.6, "kn": 1852 / 3600},
    "acceleration": {"m/s2": 1, "mm/s2": 1e-3, "cm/s2": 1e-2, "g": _G, "mg": 1e-3 * _G},
    "turn rate": {
        "rad/s": 1,
        "deg/s": _DEG,
        "mrad/s": 1e-3,
        "deg/h": _DEG / 3600,
        "rpm": _RPM,
        "rev/s": _REV,
    },
    "angular acceleration": {"rad/s2": 1, "deg/s2": _DEG},
    "force": {"N": 1, "mN": 1e-3, "kN": 1e3, "gf": 1e-3 * _G, "kgf": _G, "lbf": 4.4482216152605},
    "torque": {"Nm": 1, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 1e-2},
    "mass": {"kg": 1, "g": 1e-3, "mg": 1e-6},
    "magnetic flux density": {"T": 1, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "G": 1e-4, "mG": 1e-7},
    "voltage": {"V": 1, "mV": 1e-3},
    "current": {"A": 1, "mA": 1e-3},
    "power": {"W": 1, "mW": 1e-3},
    "pressure": {"Pa": 1, "hPa": 100, "kPa": 1e3, "mbar": 100, "bar": 1e5},
    "frequency": {"Hz": 1, "kHz": 1e3, "rpm": 1 / 60},
    "temperature": {"degC": 1},
}
#: Quantity of each unit, by the suffix for the unit in a column name, such as ``m_s`` for m/s.
SUFFIXES = {next(iter(table)).replace("/", "_"): quantity for quantity, table in UNITS.items()} | {
    "N_m": "torque"
}
#: Pattern for the part of a column name before its last unit, if this part ends in a unit, too. Then the
#: column has a compound unit, such as ``mm_s`` or ``N_m_rad``, and the last unit alone does not state the
#: quantity.
COMPOUND = re.compile(r".+_(m?N|kN|Nm|kg|[mcuk]m|c?deg|m?rad|rev)(_[sm]2?)*")
#: Names of all known units.
KNOWN = frozenset(name for table in UNITS.values() for name in table)
#: Other spellings of each unit that are accepted in files and mappings.
_SPELLED = {
    "s": ("sec", "secs", "second", "seconds"),
    "ms": ("msec", "millis", "milliseconds"),
    "us": ("micros", "usec"),
    "ns": ("nsec", "nanoseconds"),
    "m": ("metre", "metres", "meter", "meters"),
    "cm": ("centimetre", "centimetres", "centimeter", "centimeters"),
    "mm": ("millimetre", "millimetres", "millimeter", "millimeters"),
    "in": ("inch", "inches"),
    "ft": ("foot", "feet"),
    "rad": ("radians",),
    "deg": ("degree", "degrees", "°"),
    "deg/s": ("dps",),
    "rev/s": ("rps",),
    "g": ("gs", "gee"),
    "G": ("gauss",),
    "kn": ("knots",),
    "N": ("newton", "newtons"),
    "Nm": ("N m", "N·m", "N*m", "N.m", "N-m"),
    "Nmm": ("N mm", "N·mm", "N*mm", "N.mm", "N-mm"),
    "V": ("volt", "volts"),
    "degC": ("C", "°C", "celsius"),
    "px": ("pixel", "pixels"),
    "tick": ("ticks",),
}
#: Pattern of the names of columns of the log format that state no unit.
_NO_UNIT = re.compile(r"q[wxyz]|m[xyz]|(.+_)?(likelihood|score|confidence)|found|interpolated")
_SPELLINGS = {spelling: unit for unit, others in _SPELLED.items() for spelling in others}


def canonical(unit: str) -> str:
    """Return a unit in the spelling of :data:`UNITS`; an unknown unit is returned unchanged.

    >>> canonical("m/s^2"), canonical("°/s"), canonical("µT"), canonical("m s-1")
    ('m/s2', 'deg/s', 'uT', 'm/s')
    """
    # Normalise the characters of a unit: NFKC converts "m/s²" to "m/s2", and both characters for micro to the
    # same one.
    text = unicodedata.normalize("NFKC", unit.strip()).replace("μ", "u")
    text = re.sub(r"\*\*|\^", "", text)
    text = re.sub(r"[ *]s-2|/s/s", "/s2", re.sub(r"[ *]s-1", "/s", text))
    top, _, below = text.partition("/")
    joined = f"{_SPELLINGS.get(top.lower(), top)}/{below.replace('sec', 's')}"
    spelled = (text, _SPELLINGS.get(text), _SPELLINGS.get(text.lower()), text.lower(), joined)
    return next((name for name in spelled if name in KNOWN), text)


def quantity_of(column: str) -> str | None:
    """Return the quantity that a column measures, from the ending of its name; None if the name has no unit.

    >>> quantity_of("yaw_rate_rad_s"), quantity_of("torque_N_m"), quantity_of("u_mm_s"), quantity_of("valve")
    ('turn rate', 'torque', None, None)
    """
    suffix = max((suffix for suffix in SUFFIXES if column.endswith(f"_{suffix}")), key=len, default="")
    if COMPOUND.fullmatch(column.removesuffix(f"_{suffix}")):
        return None
    return SUFFIXES.get(suffix)


def states_quantity(column: str) -> bool:
    """Return whether the name of a column states its quantity, by a unit or as a known name without a unit.

    >>> states_quantity("x_m"), states_quantity("nose_likelihood"), states_quantity("column_3")
    (True, True, False)
    """
    return quantity_of(column) is not None or _NO_UNIT.fullmatch(column) is not None


def unit_factor(unit: str, column: str) -> float:
    """Return the factor from ``unit`` to the SI unit in the name of a column.

    Raises
    ------
    ValueError
        The unit is unknown, or is not a unit of the quantity of the column.

    >>> unit_factor("g", "ax_m_s2"), unit_factor("g", "load_kg"), unit_factor("ms", "t_s")
    (9.80665, 0.001, 0.001)
    """
    name, quantity = canonical(unit), quantity_of(column)
    if quantity is None:
        raise ValueError(
            f"'{column}' names no unit to convert '{unit}' to: end the name in a unit (x_m), or give a factor"
        )
    table = UNITS[quantity]
    others = [known for known, units in UNITS.items() if name in units]
    if name not in table and others:
        raise ValueError(f"'{unit}' is a unit of {others[0]}; units of '{column}' are: {', '.join(table)}")
    if name not in table:
        raise ValueError(f"unknown unit '{unit}' of {quantity}; {suggestion(name, list(table))}")
    return float(table[name])


def safe(name: str) -> str:
    """Return a name changed so that it has only letters, digits and underscores and begins with a letter.

    >>> safe("tail tip"), safe("/hip/value"), safe("2nd")
    ('tail_tip', 'hip_value', 'p2nd')
    """
    words = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return words if words[:1].isalpha() else f"p{words}"


def unique(names: Iterable[str]) -> list[str]:
    """Return names with letters, digits and underscores only (:func:`safe`) that differ from each other.

    >>> unique(["Fx 1", "Fx-1", "Fy"])
    ['Fx_1', 'Fx_1_2', 'Fy']
    """
    found: dict[str, None] = {}
    following: Counter[str] = Counter()
    for name in map(safe, names):
        others = (f"{name}_{k}" for k in count(2 + following[name]))
        chosen = next(one for one in chain([name], others) if one not in found)
        following[name] += chosen != name
        found[chosen] = None
    return [*found]
