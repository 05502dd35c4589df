"""docs/reproduction.md is what its command prints, and what it claims holds."""

from __future__ import annotations

import csv
import importlib.util
import re
import sys
from itertools import pairwise
from types import ModuleType

import pytest

from tests.conftest import ROOT

PAGE = ROOT / "docs" / "reproduction.md"
#: A figure; what stands between figures must agree to the letter.
NUMBER = re.compile(r"(?<![\w.`])[−-]?\d+(?:\.\d+)?")


@pytest.fixture(scope="module")
def script() -> ModuleType:
    path = ROOT / "docs" / "reproduction.py"
    spec = importlib.util.spec_from_file_location("reproduction", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["reproduction"] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


def _differences(printed: str, page: str, *, relative: float = 0.0) -> list[str]:
    """Lines that differ by more than one unit of a last digit, or by more than a share."""
    ours, theirs = printed.strip().splitlines(), page.strip().splitlines()
    if len(ours) != len(theirs):
        return [f"{len(ours)} lines printed, {len(theirs)} in the page"]
    return [
        f"{a}\n{b}"
        for a, b in zip(ours, theirs, strict=True)
        if a != b and not _rounding(a, b, relative=relative)
    ]


def _rounding(a: str, b: str, *, relative: float) -> bool:
    if NUMBER.sub("#", a) != NUMBER.sub("#", b):
        return False
    for x, y in zip(NUMBER.findall(a), NUMBER.findall(b), strict=True):
        unit = 10.0 ** -len(x.partition(".")[2])
        value, known = (float(n.replace("−", "-")) for n in (x, y))
        if abs(value - known) > max(1.01 * unit, relative * abs(known)):
            return False
    return True


def _parts() -> tuple[str, str]:
    first, rest = PAGE.read_text(encoding="utf-8").split("## What estimation gains over tuning by hand")
    return first, "## What estimation gains over tuning by hand" + rest


def _lines(rows: list[list[str]]) -> str:
    return "\n".join(" | ".join(row) for row in rows)


def _table(name: str) -> str:
    with (PAGE.parent / "measured" / name).open(encoding="utf-8", newline="") as file:
        return _lines(list(csv.reader(file)))


@pytest.mark.slow
def test_what_the_page_claims_holds(script: ModuleType) -> None:
    claims = script.checks()
    assert len(claims) == 3
    assert all(holds for _, holds in claims), claims


def test_dolphin_is_within_ten_percent(script: ModuleType) -> None:
    deviations = script.dolphin_deviations()
    assert len(deviations) == 3
    assert max(abs(d) for d in deviations) < 0.10


def test_yaw_peaks_are_within_five_percent(script: ModuleType) -> None:
    """In the last beat before 15 s; over three beats one row is at 5.5 %, as the page says."""
    assert max(abs(d) for d in script.tfish_yaw_deviations(1)) < 0.05
    assert 0.05 < max(abs(d) for d in script.tfish_yaw_deviations(3)) < 0.06


@pytest.mark.slow
def test_best_stiffness_rises_with_frequency(script: ModuleType) -> None:
    optima = [script.best_stiffness(f) for f in (1.0, 2.0, 3.0, 4.0, 5.0)]
    assert all(b > 1.2 * a for a, b in pairwise(optima))


def test_every_reading_of_the_robot_files_is_in_its_table(script: ModuleType) -> None:
    for name in ("tfish", "dolphin"):
        text = _table(f"reproduction-{name}-readings.csv")
        for key, option, chosen in script.readings_of(name):
            assert chosen or f"`{key}={option}`" in text


@pytest.mark.slow
def test_the_page_is_what_the_command_prints(script: ModuleType) -> None:
    assert _differences(script.page(), _parts()[0]) == []
    for name, rows in script.sheets.items():
        assert _differences(_lines(rows), _table(name)) == [], name


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::swimid.notices.SwimidWarning")
def test_the_twin_is_what_the_command_prints() -> None:
    from benchmarks import bench_tuning

    text, rows = bench_tuning.section()
    assert _differences(text, _parts()[1], relative=0.02) == []
    assert _differences(_lines(rows), _table(bench_tuning.TABLE.name), relative=0.02) == []
