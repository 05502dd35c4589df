"""Functions that format numbers and units as text for reports and terminals.

The text is Unicode: ``−`` for minus, ``×`` and superscripts for powers of ten.

>>> format_estimate(0.70512, 0.0331)
'0.705 ± 0.033'
>>> format_estimate(4.512e-5, 1.2e-6, "kg m^2")
'(4.51 ± 0.12) × 10⁻⁵ kg·m²'
>>> format_number(0.0012345678)
'0.001235'
>>> column_title("u_m_s")
'surge speed (m/s)'
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TypeGuard

#: Half-width of the two-sided 95 % interval of the normal distribution, in standard deviations.
Z95 = 1.959963984540054

#: Text that tables show in place of a missing number.
MISSING_TEXT = "–"

_SUPERSCRIPTS = str.maketrans("0123456789-+", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺")
#: Limits of the decimal exponent n of a number that is written in full. If n is at least ``_LARGE``, or below
#: ``_SMALL``, the number is written with the factor ``× 10ⁿ``.
_LARGE, _SMALL = 6, -3
#: Maximum number of significant digits of a number as text, which is the number of exact digits of a float64.
_MOST_DIGITS = 15

_UNIT_NAMES = (
    "kg m^2/s^2, N s^2/m^2, N m/rad, rad/s^2, deg/s^2, kg/m^3, kg m^2, N s/m, m/s^2, rad/s, deg/s, BL/s, "
    "kg m, N m, J/m, m/s, m^2, m^3, rad, deg, BL, Hz, kg, px, N, W, J, V, A, m, s"
)
#: Unit for each suffix that the name of a column or key may have: ``m_s2`` stands for m/s^2.
_SUFFIXES = {re.sub("[ /]", "_", u).replace("^", ""): u for u in re.split(", ", _UNIT_NAMES)} | {"hz": "Hz"}
#: Name in words for each column that has a velocity component along a body axis.
BODY_SPEEDS = {"u_m_s": "surge speed", "v_m_s": "sway speed", "w_m_s": "heave speed"}


def _is_number(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def _is_error(stderr: float | None) -> TypeGuard[float]:
    """Return whether a standard error is known and positive. Only then can it set the number of digits."""
    return _is_number(stderr) and stderr > 0


def _exponent(value: float, digits: int = _MOST_DIGITS) -> int:
    """Return the decimal exponent that a value has after it is rounded to ``digits`` significant digits."""
    return int(f"{abs(value):.{digits - 1}e}".split("e")[1])


def format_fixed(value: float, decimals: int) -> str:
    """Return a value as text with ``decimals`` decimal places.

    With -1 decimal places the value is rounded to tens, with -2 to hundreds. The text is never ``-0``.
    """
    rounded = round(float(value), decimals) + 0.0
    return f"{rounded:.{max(decimals, 0)}f}".replace("-", "−")


def power_of_ten(exponent: int) -> str:
    """Return ``10`` to an integer power as text: ``10⁻⁷``."""
    return "10" + str(exponent).translate(_SUPERSCRIPTS)


def format_number(value: float | int | None, digits: int = 4, unit: str = "") -> str:
    """Return a number as text with its unit, rounded to significant digits and without trailing zeros.

    Whole numbers (``int``) below a million keep all their digits. NaN and None are shown as a dash.
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return MISSING_TEXT
    if isinstance(value, bool):
        return ("no", "yes")[value]
    if math.isinf(value):
        return _add_unit(f"{value}".replace("-", "−").replace("inf", "∞"), unit)
    if isinstance(value, int) and abs(value) < 10**_LARGE:
        return _add_unit(str(value).replace("-", "−"), unit)
    exponent = _exponent(float(value), digits)
    if _SMALL <= exponent < _LARGE:
        return _add_unit(_trim_zeros(format_fixed(value, digits - 1 - exponent)), unit)
    mantissa = _trim_zeros(format_fixed(value / 10.0**exponent, digits - 1))
    return _add_unit(f"{mantissa} × {power_of_ten(exponent)}", unit)


def _trim_zeros(text: str) -> str:
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return text


def _layout(value: float, stderr: float, digits: int) -> tuple[int, int]:
    """Return the power of ten and the number of decimal places of a value and its standard error as text.

    The standard error has ``digits`` significant digits.
    """
    last = _exponent(stderr, digits) - digits + 1
    first = _exponent(stderr, digits)
    if value:
        first = max(first, _exponent(value))
    last = max(last, first - _MOST_DIGITS + 1)
    if _SMALL <= first < _LARGE:
        return 0, -last
    return first, first - last


def format_estimate(value: float | None, stderr: float | None, unit: str = "", digits: int = 2) -> str:
    """Return a value with its standard error and unit as text, such as ``0.705 ± 0.033 kg``.

    Both numbers are rounded to ``digits`` significant digits of the standard error.


    Without a standard error (None, NaN, infinite or zero) the text is the value alone, with six significant
    digits.

    Parameters
    ----------
    value, stderr : float or None
        Value and standard error, both in ``unit``.
    unit : str
        Unit as in result files, such as ``"m/s^2"``; ``"1"`` for a dimensionless value.
    digits : int
        Significant digits of the standard error.
    """
    if not _is_number(value):
        return MISSING_TEXT
    if not _is_error(stderr):
        return format_number(value, 6, unit)
    scale, decimals = _layout(value, stderr, digits)
    text = f"{format_fixed(value / 10.0**scale, decimals)} ± {format_fixed(stderr / 10.0**scale, decimals)}"
    if scale:
        text = f"({text}) × {power_of_ten(scale)}"
    elif unit_text(unit) == "°":
        text = f"({text})"
    return _add_unit(text, unit)


def interval(low: float | None, high: float | None, stderr: float | None = None, unit: str = "") -> str:
    """Return an interval as text with its unit, such as ``15 … 35``.

    The ends are rounded to two significant digits of the standard error. Without a standard error the ends
    have four significant digits, and two ends with the same text are written as one number.

    >>> interval(27.0, 27.0, None, "deg"), interval(15.0, 35.0)
    ('27°', '15 … 35')
    """
    if not (_is_number(low) and _is_number(high)):
        return MISSING_TEXT
    if not _is_error(stderr):
        return _add_unit(" … ".join(dict.fromkeys([format_number(low), format_number(high)])), unit)
    scale, decimals = _layout(max(low, high, key=abs), stderr, 2)
    text = f"{format_fixed(low / 10.0**scale, decimals)} … {format_fixed(high / 10.0**scale, decimals)}"
    if scale:
        text = f"({text}) × {power_of_ten(scale)}"
    return _add_unit(text, unit)


def confidence95(value: float | None, stderr: float | None) -> tuple[float, float] | None:
    """Return the ends of the 95 % interval of an estimate, ``value ± 1.96 stderr``.

    Return None without a positive standard error.
    """
    if not (_is_number(value) and _is_error(stderr)):
        return None
    return value - Z95 * stderr, value + Z95 * stderr


def bounds_text(bounds: tuple[float | None, float | None] | list[float | None] | None) -> str:
    """Return the bounds of a parameter as text: ``0 … 5``, ``≥ 0``, ``≤ 1``, or ``free`` without bounds."""
    low, high = bounds or (None, None)
    if _is_number(low) and _is_number(high):
        return f"{format_number(low)} … {format_number(high)}"
    if _is_number(low):
        return f"≥ {format_number(low)}"
    return f"≤ {format_number(high)}" if _is_number(high) else "free"


def percent(fraction: float | None, digits: int = 3) -> str:
    """Return a fraction as text in percent, such as ``14.2 %``. A fraction below 1 is never ``100 %``.

    >>> percent(0.142), percent(0.99998), percent(1.0)
    ('14.2 %', '> 99.9 %', '100 %')
    """
    if not _is_number(fraction):
        return MISSING_TEXT
    text = format_number(100.0 * fraction, digits)
    if text == "100" and fraction < 1.0:
        text = f"> {format_number(100.0 - 10.0 ** (2 - digits), digits)}"
    return f"{text} %"


def unit_text(unit: str) -> str:
    """Return a unit as it is printed: ``m/s²`` for ``m/s^2``, ``kg·m²`` for ``kg m^2``.

    A dimensionless quantity (``"1"``) has an empty text.
    """
    unit = unit.strip()
    if unit in {"", "1", "-", "none", "None"}:
        return ""
    if unit in {"deg", "degree", "degrees"}:
        return "°"
    if unit == "percent":
        return "%"
    text = re.sub(r"(\^|\*\*)\(?([-+]?\d+)\)?", lambda m: m.group(2).translate(_SUPERSCRIPTS), unit)
    text = re.sub(r"\s*/\s*", "/", text)
    text = re.sub(r"\s*[*·]\s*|(?<=\S)\s+(?=\S)", "·", text)
    return re.sub(r"\bdeg\b", "°", text)


def _add_unit(text: str, unit: str) -> str:
    printed = unit_text(unit)
    if printed and printed != "°":
        text += " "
    return text + printed


def in_degrees(unit: str) -> tuple[float, str]:
    """Return the factor and the unit by which a quantity in radians is shown in degrees.

    Other units have the factor 1 and are unchanged.

    >>> in_degrees("m/s")
    (1.0, 'm/s')
    """
    if unit in ("rad", "rad/s"):
        return math.degrees(1.0), f"deg{unit[3:]}"
    return 1.0, unit


def split_unit(name: str) -> tuple[str, str]:
    """Split the name of a column or key into its bare name and its unit.

    ``yaw_rate_rad_s`` is yaw_rate in rad/s. A name without a known suffix has the unit ``""``.
    """
    for suffix in sorted(_SUFFIXES, key=len, reverse=True):
        if name.endswith("_" + suffix):
            return name[: -len(suffix) - 1], _SUFFIXES[suffix]
    return name, ""


def quantity(name: str) -> str:
    """Return the name in words of the quantity in a column: ``yaw rate`` for ``yaw_rate_rad_s``."""
    return BODY_SPEEDS.get(name, split_unit(name)[0].replace("_", " "))


def column_title(name: str) -> str:
    """Return the axis label for a column: ``yaw rate (rad/s)`` for ``yaw_rate_rad_s``."""
    printed = unit_text(split_unit(name)[1])
    if not printed:
        return quantity(name)
    return f"{quantity(name)} ({printed})"


def join_names(names: Sequence[str], last: str = "and") -> str:
    """Return names joined as in a sentence: ``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def probability_text(probability: float | None) -> str:
    """Return text for a probability in percent; ``< 0.1 %`` for values below a thousandth."""
    if probability is not None and probability < 1e-3:
        return "< 0.1 %"
    return percent(probability, 2)
