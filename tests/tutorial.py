"""The tutorial as a user walks it: ``python -m tests.tutorial`` runs its commands and writes what they print.

A page shows a command as ``$ swimid ...`` at the beginning of a block, and what it prints after it. A line of
dots stands for lines that the page leaves out. Blocks of the language ``diff`` are edits of the file that the
page names last before them. The pictures show the results of the walk.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs/learn").glob("[0-9]*.md"))
FIGURES = ROOT / "docs/figures"
#: Line of a block that stands for lines that the page leaves out.
LEFT_OUT = "  ..."
BLOCK = re.compile(r"```(\w*)\n(.*?)```\n", re.S)
#: Picture of a page: result, figure.
PICTURES = {
    "learn-fit": ("fit.yaml", "overlay-x_m"),
    "learn-compare": ("comparison.yaml", "overlay"),
    "learn-gap": ("gap.yaml", "waterfall"),
    "learn-repaired": ("repaired-comparison.yaml", "overlay"),
}


def run(words: list[str], folder: Path) -> str:
    """Run a command of swimid and return what it prints on the standard output."""
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(
        [sys.executable, "-m", "swimid", *words], cwd=folder, env=env, capture_output=True, text=True
    )
    assert ran.returncode == 0, f"swimid {' '.join(words)}: {ran.stderr}"
    return ran.stdout


def shorten(printed: str, block: str) -> str:
    """Return the printed text, without the lines that a block of a page leaves out.

    The block goes on with the last printed line that begins with the word after the dots.
    """
    shown, lines = block.splitlines()[1:], printed.splitlines()
    if LEFT_OUT not in shown:
        return printed
    head = shown.index(LEFT_OUT)
    word = shown[head + 1].split()[0]
    tail = max(k for k, line in enumerate(lines) if line.split()[:1] == [word])
    return "\n".join([*lines[:head], LEFT_OUT, *lines[tail:]])


def walk(folder: Path) -> Iterator[tuple[Path, str, str, str]]:
    """Run all commands of the pages in order; yield page, shown block, command and what it printed."""
    here = folder
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for match in BLOCK.finditer(text):
            language, block = match.groups()
            if block.startswith("cd "):
                here /= block.split()[1]
            elif language == "diff":
                file = here / re.findall(r"`([\w.-]+\.yaml)`", text[: match.start()])[-1]
                old, new = (line[1:] for line in block.splitlines())
                content = file.read_text()
                assert old in content, f"{page.name}: {file.name} has no '{old}'"
                file.write_text(content.replace(old, new, 1))
            elif block.startswith("$ swimid "):
                command = block.splitlines()[0].removeprefix("$ swimid ")
                yield page, block, command, shorten(run(shlex.split(command), here).rstrip("\n"), block)


def draw(project: Path) -> None:
    """Draw the pictures of the pages from the results of a walk."""
    import cv2
    import matplotlib.pyplot as plt

    import swimid

    plt.rcParams["svg.hashsalt"] = "swimid"
    for name, (file, figure) in PICTURES.items():
        axes = swimid.load_result(project / file).plot(figure)
        first = axes[0] if isinstance(axes, list) else axes
        first.get_figure(root=True).savefig(FIGURES / f"{name}.svg", metadata={"Date": None})
        plt.close("all")
    shutil.copy(project / "run03.svg", FIGURES / "learn-log.svg")
    sheet = cv2.imread(str(project / "film-1.setup.markers.png"))
    cv2.imwrite(str(FIGURES / "learn-markers.jpg"), sheet[: len(sheet) // 2])
    film = cv2.VideoCapture(str(project.parent / "films/run03.mp4"))
    film.set(cv2.CAP_PROP_POS_FRAMES, 120)
    cv2.imwrite(str(FIGURES / "learn-film.jpg"), film.read()[1])


def main() -> None:
    """Run the tutorial, write what its commands print into the pages, and draw the pictures."""
    with tempfile.TemporaryDirectory() as name:
        for page, block, command, printed in walk(Path(name)):
            print(f"{page.name}: swimid {command}", flush=True)
            shown = f"$ swimid {command}\n{printed}\n" if printed else f"$ swimid {command}\n"
            text = page.read_text(encoding="utf-8").replace(block, shown)
            page.write_text(text, encoding="utf-8")
        draw(Path(name) / "project")


if __name__ == "__main__":
    main()
