"""Recorded inputs of ``swimid import`` that once ended with a wrong number and a good verdict."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import Ran

Run = Callable[..., Ran]
Case = Callable[..., Path]
HEAD = "format: swimid-mapping/1\n"


@pytest.fixture
def imported(swimid: Run) -> Callable[..., dict[str, Any]]:
    """Import a file; return what the command found."""

    def run(file: str, *options: str) -> dict[str, Any]:
        ran = swimid("import", file, *options, "-o", "out.csv", "--force", "--json")
        assert ran.status == 0, ran.err
        return ran.json["result"]

    return run


@pytest.fixture
def drafted(swimid: Run) -> Callable[[str], str]:
    """Draft the mapping of a file as ``map.yaml``; return its text."""

    def draft(file: str) -> str:
        assert swimid("import", file, "--guess", "-o", "map.yaml", "--force").status == 0
        return Path("map.yaml").read_text()

    return draft


def _answer(text: str, **answers: str) -> None:
    """Write the draft with its questions answered, and without the lines that stay open."""
    for key, value in answers.items():
        text = text.replace(f"{key}: ASK", f"{key}: {value}")
    lines = [line for line in text.splitlines() if "ASK" not in line.partition("#")[0]]
    Path("map.yaml").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("file", "time"),
    [
        ("d02_datetime.csv", "{source: [Date, Time], origin: first}"),
        ("d03b_tod.csv", "{source: Time, origin: first}"),
        ("d08_dayfirst.csv", "{source: time, format: '%d/%m/%Y %H:%M:%S.%f', origin: first}"),
        ("d09_comma.csv", "{source: time, origin: first}"),
        ("d11_secnsec.csv", "{source: [secs, nsecs], unit: [s, ns], origin: first}"),
    ],
)
def test_times_in_parts(
    file: str, time: str, case: Case, imported: Any, drafted: Callable[[str], str]
) -> None:
    case("c-15-split-and-other-time-columns")
    columns = "columns: [{source: x_m, target: x_m}, {source: yaw_rad, target: yaw_rad}]\n"
    Path("map.yaml").write_text(f"{HEAD}time: {time}\n{columns}")
    result = imported(file, "--map", "map.yaml")
    assert result["samples"] == 600
    assert result["duration_s"] == pytest.approx(59.9, abs=1e-6)
    assert result["median_rate_hz"] == pytest.approx(10, rel=1e-6)
    assert result["verdict"]["level"] == "good"
    _answer(re.sub("time: .*", f"time: {time}", drafted(file)))
    assert imported(file, "--map", "map.yaml")["duration_s"] == pytest.approx(59.9, abs=1e-6)


def test_a_time_that_lacks_a_part_is_not_trusted(case: Case, imported: Any, swimid: Run) -> None:
    case("c-15-split-and-other-time-columns")
    columns = "columns: [{source: x_m, target: x_m}]\n"
    Path("map.yaml").write_text(HEAD + "time: {source: secs}\n" + columns)
    assert imported("d11_secnsec.csv", "--map", "map.yaml")["verdict"]["level"] == "bad"
    Path("map.yaml").write_text(HEAD + "time: {source: Date}\n" + columns)
    ran = swimid("import", "d02_datetime.csv", "--map", "map.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "1 of 600 rows" in ran.err


@pytest.mark.parametrize(("file", "period"), [("d05_u16ms.csv", 65536), ("d05b_u32us.csv", 4294967296)])
def test_a_counter_that_wraps(
    file: str, period: int, case: Case, imported: Any, drafted: Callable[[str], str], swimid: Run
) -> None:
    case("c-28-counter-wraps-and-dst")
    text = drafted(file)
    ran = swimid("import", file, "--map", "map.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "wraps_at: " in ran.err
    Path("map.yaml").write_text(text.replace("time: {", f"time: {{wraps_at: {period}, "))
    result = imported(file, "--map", "map.yaml")
    assert result["samples"] == 600
    assert result["median_rate_hz"] == pytest.approx(10, rel=1e-6)


@pytest.mark.slow
def test_local_time_that_steps_by_an_hour(case: Case, imported: Any, drafted: Any, swimid: Run) -> None:
    case("c-28-counter-wraps-and-dst")
    drafted("d04_dst_back.csv")
    ran = swimid("import", "d04_dst_back.csv", "--map", "map.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "line 202" in ran.err
    assert imported("d04b_dst_fwd.csv", "--map", "map.yaml")["verdict"]["level"] == "caution"
    drafted("d01_wholesec.csv")
    assert imported("d01_wholesec.csv", "--map", "map.yaml")["median_rate_hz"] == pytest.approx(10)


@pytest.mark.parametrize("name", ["row", "idx", "axis", "n", ""])
def test_a_counter_of_any_name(name: str, case: Case, drafted: Callable[[str], str], imported: Any) -> None:
    folder = case("r-guess-row-counter-as-time", "make.py")
    lines = (folder / "frames.csv").read_text().splitlines()
    lines[0] = ",".join([name, *lines[0].split(",")[1:]])
    (folder / "named.csv").write_text("\n".join(lines) + "\n")
    text = drafted("named.csv").replace("time: ASK", "time: {frame: 1, rate_hz: ASK}")
    assert "rate_hz: ASK" in text
    _answer(text, rate_hz="25")
    result = imported("named.csv", "--map", "map.yaml")
    assert result["speed"]["path_m_s"] == pytest.approx(0.2069, rel=0.01)
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=0.01)
