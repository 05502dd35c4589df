"""Messages, next commands and pages of inputs that once misled."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

from tests.conftest import Ran
from tests.test_next_commands import on_page

Case = Callable[..., Path]
Run = Callable[..., Ran]


def test_next_unquoted(case: Case, swimid: Run) -> None:
    folder = case("t4-next-unquoted")
    ran = swimid("fit-drag", "my $(touch pwned).yaml", "-o", "d r.yaml")
    line = ran.stderr.splitlines()[-1]
    expected = [
        "swimid",
        "compare",
        "my $(touch pwned).yaml",
        "--params",
        "d r.yaml",
        "-o",
        "comparison.yaml",
    ]
    assert shlex.split(line.removeprefix("next: ")) == expected
    assert swimid("report", "d r.yaml", "-o", "page.html").status == 0
    assert on_page(folder / "page.html") == [expected]


def test_comma_in_yaml(case: Case, swimid: Run) -> None:
    case("t4-comma-in-yaml")
    ran = swimid("fit-drag", "comma.yaml")
    assert ran.status == 3
    assert "comma.yaml, line 6" in ran.err
    assert "'0,010' is read as two values; write 0.010" in ran.err
