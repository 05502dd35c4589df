"""The picture in docs/architecture.md, held to: imports run one way, and --help stays light."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from swimid import notices
from tests.conftest import ROOT

PACKAGE = Path(notices.__file__).parent
PICTURE = ROOT / "docs" / "architecture.md"
#: The rooms from the ground up: each imports from itself and from those of the rows before its own.
LEVELS = (
    {"errors", "notices", "progress", "options"},
    {"files"},
    {"results", "robots"},
    {"logs"},
    {"tracking", "inertial", "fitting"},
    {"rig", "propulsion", "swimmer", "blackbox"},
    {"effects"},
    {"simulation", "exporters"},
    {"diagnosis", "sensitivity_analysis", "optimisation"},
    {"cli"},
)
LEVEL = {room: level for level, rooms in enumerate(LEVELS) for room in rooms}


def _modules() -> list[Path]:
    return [p for p in PACKAGE.rglob("*.py") if p.parent != PACKAGE and "__pycache__" not in p.parts]


@pytest.mark.parametrize("path", _modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_run_one_way(path: Path) -> None:
    room = path.relative_to(PACKAGE).parts[0]
    for node in ast.walk(ast.parse(path.read_text())):
        names = [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        if isinstance(node, ast.ImportFrom) and node.module == "swimid":
            names = [f"swimid.{alias.name}" for alias in node.names]
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            if name.startswith("swimid."):
                other = name.split(".")[1]
                below = other == room or LEVEL[other] < LEVEL[room]
                assert below, f"{path}: {room} may not import {name}"


def test_every_room_is_in_the_picture() -> None:
    rooms = {p.name for p in PACKAGE.iterdir() if (p / "__init__.py").exists()}
    assert rooms == set(LEVEL) - LEVELS[0]


@pytest.fixture(scope="module")
def counted() -> ModuleType:
    """The developers' command that counts the rooms."""
    spec = importlib.util.spec_from_file_location("rooms", ROOT / "docs" / "rooms.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_nothing_goes_round_in_circles(counted: ModuleType) -> None:
    graph = counted.imports()
    arrows = counted.between_rooms(graph, counted.rooms())
    assert counted.cycle({name: set(others) for name, others in arrows.items()}) == []
    assert counted.cycle(graph) == []


def test_a_circle_is_found(counted: ModuleType, tmp_path: Path) -> None:
    package = tmp_path / "swimid"
    files = {
        "__init__.py": "",
        "low/__init__.py": "",
        "low/a.py": "def late():\n    from swimid.high import b\n",
        "high/__init__.py": "",
        "high/b.py": "from swimid.high.c import name\n",
        "high/c.py": "import swimid.low.a\n",
        "high/d.py": "if TYPE_CHECKING:\n    from swimid.low import a\n",
    }
    for name, text in files.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    graph = counted.imports(package)
    assert graph["high.b"] == {"high.c"}
    assert graph["high.d"] == set()
    assert set(counted.cycle(graph)) == {"low.a", "high.b", "high.c"}
    arrows = counted.between_rooms(graph, counted.rooms(package))
    assert arrows == {"low": {"high": 1}, "high": {"low": 1}}


def test_the_rooms_are_printed(counted: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    assert counted.main([]) == 0
    shown = capsys.readouterr().out
    assert {line.split()[0] for line in shown.splitlines()} >= set(LEVEL) - LEVELS[0]
    assert "cycles between rooms: none" in shown
    assert counted.main(["rig"]) == 0
    assert "rig.model" in capsys.readouterr().out
    assert counted.main(["no-room"]) == 2


def test_the_picture_names_every_room() -> None:
    """The table of rooms is complete, and its levels are those the imports are held to."""
    text = PICTURE.read_text(encoding="utf-8")
    table = re.findall(r"^\| `(\w+)` \|", text, re.M)
    assert sorted(table) == sorted(set(LEVEL) - LEVELS[0])
    (block,) = re.findall(r"## Imports run one way\n.*?```\n(.*?)```", text, re.S)
    drawn = [set(re.findall(r"\w+", line)) for line in block.splitlines()]
    assert drawn == list(reversed(LEVELS))


def test_the_picture_names_what_is_there() -> None:
    """Every ``room/module.py`` of the documents for developers, and every ``room/folder/``."""
    place = re.compile(r"`(?:swimid/)?([a-z_]+/[a-z_/]*(?:\w+\.(?:py|yaml|md))?)`(?!:$)", re.M)
    for page in (PICTURE, ROOT / "CONTRIBUTING.md"):
        for name in place.findall(page.read_text(encoding="utf-8")):
            inside = PACKAGE if name.split("/")[0] in LEVEL else ROOT
            assert (inside / name).exists(), f"{page.name} names {name}"


@pytest.mark.parametrize("room", sorted(set(LEVEL) - LEVELS[0]))
def test_a_room_says_what_is_in_it(room: str) -> None:
    """The docstring of a room names modules of it, and none that is not there."""
    folder = PACKAGE / room
    said = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    assert said is not None
    head = re.split(r"^-{4,}$", said, flags=re.M)[0]
    names = re.findall(r"``(\w+)``", head)
    inside = {path.stem for path in folder.glob("*.py")} | {
        path.name for path in folder.iterdir() if path.is_dir()
    }
    assert names, f"{room}: names none of its modules"
    assert set(names) <= inside, f"{room}: {set(names) - inside}"


def test_help_imports_nothing_heavy() -> None:
    """numpy and what is heavier stay out of --help and completion."""
    code = (
        "import sys; from swimid.cli.main import main; main(['--help'], standalone_mode=False); "
        "heavy = "
        "{'numpy', 'scipy', 'pandas', 'numba', 'cv2', 'control', 'filterpy', 'matplotlib', 'pydantic'}; "
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stderr.strip() == "[]"


def test_every_warning_code_is_used_and_documented() -> None:
    source = "".join(p.read_text() for p in PACKAGE.rglob("*.py") if p.name != "notices.py")
    manual = (PACKAGE.parent / "docs" / "warnings.md").read_text()
    for code in notices.CODES:
        assert code in source, f"{code} is never raised"
        assert code in manual, f"{code} is not in docs/warnings.md"
