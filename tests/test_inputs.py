"""Every file that a command opens is an input of its result, and a result does not state where files are."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import swimid as package
from swimid.errors import InputError
from tests.conftest import SAMPLES, Ran, interrupting

Run = Callable[..., Ran]

_watched: list[str] = []
_watching = False


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if _watching and event == "open" and isinstance(arguments[0], str) and "w" not in (arguments[1] or "r"):
        _watched.append(os.path.abspath(arguments[0]))


sys.addaudithook(_audit)


@contextmanager
def watched(folder: Path) -> Iterator[set[str]]:
    """Collect the names of the files of a folder that Python opens in a block, without those it writes."""
    global _watching
    before = {path.resolve() for path in folder.rglob("*") if path.is_file()}
    found: set[str] = set()
    _watched.clear()
    _watching = True
    try:
        yield found
    finally:
        _watching = False
        found |= {Path(path).name for path in _watched if Path(path).resolve() in before}


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a rig, a log that another file complements, and a table of idtracker."""
    folder = tmp_path / "home" / "alice" / "lab"
    shutil.copytree(SAMPLES / "rig", folder)
    time_s = np.arange(200) / 50
    table = np.column_stack([time_s, np.sin(time_s), np.cos(time_s)])
    np.savetxt(folder / "a.csv", table, delimiter=",", header="time,x,y", comments="", fmt="%.6f")
    np.savetxt(folder / "force.csv", table[:, :2], delimiter=",", header="time,F", comments="", fmt="%.6f")
    (folder / "map.yaml").write_text(
        "format: swimid-mapping/1\ntime: {source: time, unit: s}\n"
        "columns: [{source: x, target: x_m, unit: m}, {source: y, target: y_m, unit: m}]\n"
        "join: [{file: force.csv, time: {source: time, unit: s}, "
        "columns: [{source: F, target: force_N, unit: N}]}]\n"
    )
    tracks = folder / "trajectories"
    tracks.mkdir()
    pixels = np.column_stack([100 + 50 * np.cos(time_s), 100 + 50 * np.sin(time_s)])
    np.savetxt(tracks / "t.csv", pixels, delimiter=",", header="x1,y1", comments="", fmt="%.3f")
    (tracks / "attributes.json").write_text('{"frames_per_second": 50, "version": "6"}')
    monkeypatch.chdir(folder)
    monkeypatch.setenv("HOME", str(folder.parent))
    return folder


COMMANDS = {
    "import with join": ["import", "a.csv", "--map", "map.yaml", "-o", "o.csv"],
    "import of idtracker": ["import", "trajectories/t.csv", "-o", "o.csv"],
    "fit-drag": ["fit-drag", "trials.yaml", "-o", "o.yaml"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_all_files_that_are_opened_are_inputs(lab: Path, swimid: Run, name: str) -> None:
    with watched(lab) as opened:
        ran = swimid(*COMMANDS[name])
    assert ran.status == 0, ran.err
    inputs = json.loads((lab / "o.evidence.json").read_text())["provenance"]["inputs"]
    assert opened
    assert opened <= {Path(path).name for path in inputs}


def test_a_result_is_the_same_from_any_folder(
    lab: Path, swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    monkeypatch.setattr(sys, "argv", ["swimid", "import", "a.csv", "--map", "map.yaml", "-o", "o.csv"])
    assert swimid(*sys.argv[1:]).status == 0
    first = [(lab / name).read_bytes() for name in ("o.csv", "o.evidence.json")]
    monkeypatch.chdir(tmp_path)
    words = ["swimid", "import", *(str(lab / one) for one in ("a.csv", "map.yaml", "o.csv"))]
    words[3:3], words[5:5] = ["--map"], ["-o"]
    monkeypatch.setattr(sys, "argv", words)
    assert swimid(*words[1:]).status == 0
    assert [(lab / name).read_bytes() for name in ("o.csv", "o.evidence.json")] == first


def test_published_files_do_not_name_the_home_folder(
    lab: Path, swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    public = tmp_path / "public"
    public.mkdir()
    monkeypatch.chdir(public)
    words = ["fit-drag", str(lab / "trials.yaml"), "-o", "drag.yaml"]
    monkeypatch.setattr(sys, "argv", ["swimid", *words])
    assert swimid(*words).status == 0
    assert swimid("report", lab / "../lab/../../../public/drag.yaml", "-o", "page.html").status == 0
    package_folder = str(Path(package.__file__).parents[1])
    for path in public.iterdir():
        text = path.read_text()
        assert "alice" not in text, path
        assert package_folder not in text, path
    inputs = json.loads((public / "drag.evidence.json").read_text())["provenance"]["inputs"]
    assert {"trials.yaml", "w10.csv", "swimid/robots/boxfish.yaml"} <= set(inputs)


def test_threads_are_not_stated(lab: Path, swimid: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["import", "a.csv", "--map", "map.yaml", "-o", "o.csv"]
    monkeypatch.setattr(sys, "argv", ["swimid", *words, "--jobs", "3"])
    assert swimid(*words).status == 0
    command = json.loads((lab / "o.evidence.json").read_text())["provenance"]["command"]
    assert command == "swimid import a.csv --map map.yaml -o o.csv"


@pytest.mark.slow
@pytest.mark.parametrize("change", ["effect", "table"])
def test_a_search_begins_anew_if_its_effect_has_changed(lab: Path, change: str) -> None:
    (lab / "rate.txt").write_text("1.0\n")
    effect = (
        "import numpy as np\nfrom pathlib import Path\nfrom swimid.effects.base import Effect\n"
        "from swimid.fitting.model import Hooks, Parameter\n"
        "FACTOR = 1.0 * float(open(Path(__file__).with_name('rate.txt')).read())\n"
        "class Droop(Effect):\n    name, stage, meaning = 'droop', 'actuation', 'The drive decays.'\n"
        "    sources, needs = ('own',), frozenset({'command'})\n"
        "    def parameters(self, model, trials):\n"
        "        return (Parameter('rate_1_s', '1/s', lower=0.0, upper=0.5, start=0.0, scale=0.01),)\n"
        "    def hooks(self, values, trial, model):\n"
        "        rate = FACTOR * values[0]\n"
        "        return Hooks(command=(lambda t, a, joint: a * np.exp(-rate * t),))\n"
    )
    (lab / "droop.py").write_text(effect)
    text = (SAMPLES / "gap" / "params.yaml").read_text()
    row = '  droop/rate_1_s: {value: 0.2, stderr: 0.01, unit: "1/s", bounds: [0, 0.5], status: estimated}\n'
    text = text.replace("parameters:\n", f"effects: [droop]\nparameters:\n{row}", 1)
    (lab / "params.yaml").write_text(text)
    given: dict[str, Any] = {
        "params": "params.yaml", "own_effects": (Path("droop.py"),), "amplitude_deg": 20, "jobs": 1,
        "over": {"frequency_hz": (0.8, 1.6, 9)}, "duration_s": 4,
    }  # fmt: skip
    with pytest.raises(KeyboardInterrupt):
        package.performance_map(output="map.yaml", progress=interrupting(1), **given)
    assert (lab / "map.yaml.partial").exists()
    if change == "effect":
        (lab / "droop.py").write_text(effect.replace("FACTOR = 1.0", "FACTOR = 3.0"))
    else:
        (lab / "rate.txt").write_text("3.0\n")
    with pytest.warns(UserWarning, match="SWM150"):
        resumed = package.performance_map(output="map.yaml", **given)
    assert {"droop.py", "rate.txt"} <= set(resumed.evidence.provenance["inputs"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["setup.yaml", "film.mp4"])
def test_an_input_that_changes_while_it_is_used_is_said(lab: Path, name: str) -> None:
    shutil.copy(SAMPLES / "pool" / "pool.mp4", lab / "film.mp4")
    shutil.copy(SAMPLES / "pool" / "pool_setup.yaml", lab / "setup.yaml")
    sha256 = hashlib.sha256((lab / name).read_bytes()).hexdigest()

    def append(amount: int = 1) -> None:
        with (lab / name).open("ab") as stream:
            stream.write(b"# more\n")

    def appending(_description: str, total: int | None = None) -> Any:
        return nullcontext(append)

    given: dict[str, Any] = {"setup": lab / "setup.yaml", "progress": appending}
    if name == "film.mp4":
        with pytest.raises(InputError, match=r"film\.mp4: has changed while it was read"):
            package.track_video(lab / "film.mp4", **given)
        return
    with pytest.warns(UserWarning, match=r"SWM176 setup\.yaml has changed since it was read"):
        made = package.track_video(lab / "film.mp4", **given)
    assert made.evidence.provenance["inputs"][name] == sha256
