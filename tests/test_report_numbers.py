"""Numbers as people read them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swimid.results import numbers
from swimid.results.parameters import Fitted
from tests import report_cases


@pytest.mark.parametrize(
    ("value", "stderr", "unit", "text"),
    [
        (0.70512, 0.0331, "1", "0.705 ± 0.033"),
        (0.685, 0.037, "kg", "0.685 ± 0.037 kg"),
        (0.0308, 0.001, "N", "0.0308 ± 0.0010 N"),
        # Rounding the standard error up to the next power of ten takes a decimal away.
        (1.2345, 0.0996, "m", "1.23 ± 0.10 m"),
        (0.001, 0.5, "", "0.00 ± 0.50"),
        (-1e-9, 0.5, "", "0.00 ± 0.50"),
        (-3.14159, 0.02, "rad", "−3.142 ± 0.020 rad"),
        (12345.6, 234.0, "N", "12350 ± 230 N"),
        (4.512e-5, 1.2e-6, "kg m^2", "(4.51 ± 0.12) × 10⁻⁵ kg·m²"),
        (-2.5e8, 1.1e7, "1", "(−2.50 ± 0.11) × 10⁸"),
        (5.42, 0.31, "deg", "(5.42 ± 0.31)°"),
        (0.705, None, "1", "0.705"),
        (0.705, math.nan, "1", "0.705"),
        (0.705, 0.0, "kg", "0.705 kg"),
        (9.80665, None, "m/s^2", "9.80665 m/s²"),
        (math.nan, 0.1, "m", "–"),
        (None, None, "m", "–"),
    ],
)
def test_measured(value: float | None, stderr: float | None, unit: str, text: str) -> None:
    """A value is rounded to two digits of its standard error."""
    assert numbers.format_estimate(value, stderr, unit) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"),
        (0.0, "0"),
        (12, "12"),
        (123456, "123456"),
        (1.0, "1"),
        (0.142, "0.142"),
        (0.0012345678, "0.001235"),
        (0.00012345678, "1.235 × 10⁻⁴"),
        (99999.6, "100000"),
        (1234567.0, "1.235 × 10⁶"),
        (-0.5, "−0.5"),
        (math.nan, "–"),
        (math.inf, "∞"),
        (None, "–"),
        (True, "yes"),
    ],
)
def test_number(value: float | None, text: str) -> None:
    """Four significant digits, no trailing zeros, powers of ten only where needed."""
    assert numbers.format_number(value) == text


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("1", ""),
        ("", ""),
        ("kg", "kg"),
        ("m/s^2", "m/s²"),
        ("kg m^2", "kg·m²"),
        ("N*s/m", "N·s/m"),
        ("s^-1", "s⁻¹"),
        ("m**3", "m³"),
        ("deg", "°"),
        ("deg/s", "°/s"),
        ("kg / m^3", "kg/m³"),
    ],
)
def test_unit(unit: str, text: str) -> None:
    """Units get superscripts and a middle dot; a pure number has none."""
    assert numbers.unit_text(unit) == text


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("x_m", "x (m)"),
        ("u_m_s", "surge speed (m/s)"),
        ("ax_m_s2", "ax (m/s²)"),
        ("yaw_rate_rad_s", "yaw rate (rad/s)"),
        ("force_N", "force (N)"),
        ("qw", "qw"),
        ("m", "m"),
        ("t_s", "t (s)"),
    ],
)
def test_column_title(name: str, title: str) -> None:
    """The unit suffix of a column becomes the bracket of its axis label."""
    assert numbers.column_title(name) == title


def test_bounds_and_intervals() -> None:
    """Open bounds read as inequalities; an interval has the digits of its standard error."""
    assert numbers.bounds_text((0.0, None)) == "≥ 0"
    assert numbers.bounds_text((None, 1.0)) == "≤ 1"
    assert numbers.bounds_text((0.0, 5.0)) == "0 … 5"
    assert numbers.bounds_text((-math.inf, math.inf)) == "free"
    assert numbers.bounds_text(None) == "free"
    assert numbers.interval(0.6403, 0.7697, 0.033) == "0.640 … 0.770"
    assert numbers.interval(4.3e-5, 4.75e-5, 1.2e-6) == "(4.30 … 4.75) × 10⁻⁵"
    assert numbers.interval(None, 1.0) == "–"
    assert numbers.percent(0.1423) == "14.2 %"


def test_confidence_covers_1_96_standard_errors() -> None:
    """The 95 % interval is the normal one; there is none without a standard error."""
    low, high = numbers.confidence95(1.0, 0.1) or (0.0, 0.0)
    assert low == pytest.approx(0.804004, abs=1e-6)
    assert high == pytest.approx(1.195996, abs=1e-6)
    assert numbers.confidence95(1.0, None) is None
    assert numbers.confidence95(1.0, math.inf) is None


def _read(text: str) -> float:
    return float(text.replace("−", "-"))


@given(value=st.floats(-1e12, 1e12, allow_nan=False), relative=st.floats(1e-8, 1e3))
def test_rounding_loses_less_than_a_tenth_of_the_standard_error(value: float, relative: float) -> None:
    """What is printed reads back within 5 % of the standard error, whatever the size."""
    stderr = max(abs(value), 1e-12) * relative
    text = numbers.format_estimate(value, stderr)
    found = re.fullmatch(r"\(?(−?[\d.]+) ± ([\d.]+)\)?(?: × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?", text)
    assert found, text
    power = 10.0 ** int((found[3] or "⁰").translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")))
    assert abs(_read(found[1]) * power - value) <= 0.051 * stderr
    assert abs(_read(found[2]) * power - stderr) <= 0.051 * stderr


def test_the_table_of_parameters_has_their_intervals(tmp_path: Path) -> None:
    """The interval is the value and 1.96 standard errors; other parameters than estimated have none."""
    tables = Fitted.load(report_cases.drag(tmp_path, proof=False)).tables()
    found = tables["parameters"].set_index("parameter")["95 % interval"]
    assert found["added_mass"] == "0.612 … 0.758"
    assert found["pulley_friction"] == "0.0288 … 0.0328"
    assert found["pulley_inertia"] == "(4.28 … 4.75) × 10⁻⁵"
    assert (found[["linear_drag", "string_stiffness", "water_density"]] == "").all()
    assert tables["derived"]["95 % interval"].tolist() == ["0.1620 … 0.1702"]


def test_texts_of_probabilities_and_percentages() -> None:
    assert numbers.probability_text(0.1234) == "12 %"
    assert numbers.probability_text(0.0012) == "0.12 %"
    assert numbers.probability_text(0.00099) == "< 0.1 %"
    assert numbers.probability_text(1.0) == "100 %"
    assert numbers.probability_text(0.9999) == "> 99 %"
    assert numbers.probability_text(None) == "–"
    assert numbers.join_names(["a"]) == "a"
    assert numbers.join_names(["a", "b", "c"], "or") == "a, b or c"
