"""The tutorial shows what its commands print."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import tutorial


@pytest.mark.slow
def test_the_tutorial_shows_what_its_commands_print(tmp_path: Path) -> None:
    number = 0
    for page, block, command, printed in tutorial.walk(tmp_path):
        assert block.partition("\n")[2].rstrip("\n") == printed, f"{page.name}: swimid {command}"
        number += 1
    assert number > 8
    assert "EXPLAINED: servo-backlash" in (tutorial.ROOT / "docs/learn/04-diagnose.md").read_text()
