"""The walk through a robot of one's own: its commands run, and find what made its logs."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from swimid.results import parameters as parameters_format
from tests.conftest import ROOT, Ran, command
from tests.generators import eel_logs

EXAMPLES = ROOT / "docs" / "examples"
TEXT = (ROOT / "docs" / "learn" / "own-robot.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^swimid (.*)$", TEXT, re.M)


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Ran]]:
    """The folder in which every command of the page ran, and what each said."""
    folder = tmp_path_factory.mktemp("examples")
    shutil.copy(EXAMPLES / "eel.yaml", folder)
    shutil.copytree(EXAMPLES / "eel", folder / "eel")
    said = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in COMMANDS:
            said[line] = command(*shlex.split(line))
    return folder, said


def _said(said: dict[str, Ran], *words: str) -> Ran:
    return next(ran for line, ran in said.items() if all(w in line for w in words))


def test_every_command_ends_well(walked: tuple[Path, dict[str, Ran]]) -> None:
    folder, said = walked
    assert {line.split()[0] for line in COMMANDS} >= {"simulate", "fit-graybox", "compare", "report"}
    assert {line: ran.status for line, ran in said.items()} == dict.fromkeys(said, 0)
    for name in ("guess.csv", "eel.gif", "eel_fit.yaml", "eel_comparison.yaml", "eel.html", "faster.csv"):
        assert (folder / name).stat().st_size > 0


def test_coefficients_are_found(walked: tuple[Path, dict[str, Ran]]) -> None:
    file = parameters_format.read(walked[0] / "eel_fit.yaml")
    for name, true in eel_logs.TRUTH.items():
        found = file.parameters[name]
        assert found.status == "estimated"
        assert found.stderr is not None
        assert abs(found.value - true) < 3.0 * found.stderr, name
        assert found.stderr < 0.05 * true


def test_the_held_out_log_is_followed_to_its_noise(walked: tuple[Path, dict[str, Ran]]) -> None:
    file = parameters_format.read(walked[0] / "eel_fit.yaml")
    assert file.fit is not None
    for channel, score in file.fit.validation["channels"].items():
        assert score["rmse"] == pytest.approx(eel_logs.NOISE[channel], rel=0.1)


def test_the_page_prints_what_the_fit_prints(walked: tuple[Path, dict[str, Ran]]) -> None:
    shown = re.findall(r"^  (\w+)\s+([\d.]+) ± ([\d.]+)", TEXT, re.M)
    file = parameters_format.read(walked[0] / "eel_fit.yaml")
    assert [name for name, *_ in shown] == list(eel_logs.TRUTH)
    for name, value, error in shown:
        found = file.parameters[name]
        assert found.value == pytest.approx(float(value), abs=0.2 * float(error))
        assert found.stderr == pytest.approx(float(error), rel=0.1)


def test_the_wrong_reading_is_told(walked: tuple[Path, dict[str, Ran]]) -> None:
    out = _said(walked[1], "fit-graybox", "isotropic").out
    assert "BAD:" in out
    assert "not identifiable" in out


def test_speeds_in_the_text(walked: tuple[Path, dict[str, Ran]]) -> None:
    for words, text in (
        (("--robot",), r"mean speed of ([\d.]+) m/s"),
        (("1.2",), r"gait gives ([\d.]+) m/s"),
    ):
        shown, printed = (
            re.search(text, TEXT),
            re.search(r"mean speed\s+([\d.]+)", _said(walked[1], *words).out),
        )
        assert shown is not None
        assert printed is not None
        assert float(printed.group(1)) == pytest.approx(float(shown.group(1)), abs=6e-4)


@pytest.mark.slow
def test_the_logs_are_the_generators(tmp_path: Path) -> None:
    eel_logs.write(tmp_path)
    for name in eel_logs.DRIVES:
        made, kept = (
            np.genfromtxt(folder / f"{name}.csv", delimiter=",", skip_header=3)
            for folder in (tmp_path, EXAMPLES / "eel")
        )
        np.testing.assert_allclose(made, kept, atol=1e-6)
    assert (tmp_path / "trials.yaml").read_text() == (EXAMPLES / "eel" / "trials.yaml").read_text()
