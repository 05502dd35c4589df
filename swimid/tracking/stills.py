"""A film as pictures: a folder of them, or a pattern of their names (``pool/%05d.png``)."""

from __future__ import annotations

import math
import re
from collections import Counter
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, UsageError
from swimid.notices import warn

ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm")
#: A place holder of C's printf for a whole number.
_HOLDER = re.compile(r"%0?\d*d")


def is_sequence(path: Path) -> bool:
    """Whether a path means many pictures: a folder, or a pattern that is not itself a file."""
    return path.is_dir() or (not path.exists() and _HOLDER.search(path.name) is not None)


class Stills:
    """Pictures read one after the other, in the order of the numbers in their names.

    Parameters
    ----------
    path : path
        A folder, or a pattern with one ``%d`` in the name.
    apply_rotation : bool
        Turn the pictures as their EXIF tag says.

    Raises
    ------
    InputError
        When there is no picture, none can be decoded, or a folder holds several series.

    Attributes
    ----------
    files : list of path
    position : int
        Place of the picture last read in the series: a missing one leaves its place.
    stamp_s : float
        NaN: pictures carry no time.
    """

    stamp_s = math.nan

    def __init__(self, path: Path, *, apply_rotation: bool = True) -> None:
        self.path = path
        self.files = _listed(path)
        self._positions = _positions(path, self.files)
        self._flags = cv2.IMREAD_COLOR if apply_rotation else cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        self._next = 0
        self._bad: list[str] = []
        self._size: tuple[int, ...] | None = None
        self.position = 0

    def read(self) -> NDArray[np.uint8] | None:
        """The next picture in BGR, shape (rows, columns, 3); None after the last.

        Raises
        ------
        InputError
            When a picture differs in size from the first.
        """
        while self._next < len(self.files):
            index, self._next = self._next, self._next + 1
            file = self.files[index]
            frame = cv2.imread(str(file), self._flags)
            if frame is None:
                self._bad.append(file.name)
                continue
            self._size = self._size or frame.shape
            if frame.shape != self._size:
                here, before = (f"{size[1]} x {size[0]}" for size in (frame.shape, self._size))
                raise InputError(
                    f"is {here} pixels, those before it are {before}",
                    file=file,
                    hint="all pictures of a film have one size; name them by a pattern (%05d.png) where "
                    "others lie beside them",
                )
            self.position = self._positions[index]
            return np.asarray(frame, np.uint8)
        if self._bad:
            warn(
                "SWM044",
                f"{self.path.name}: {len(self._bad)} of {len(self.files)} pictures could not be decoded "
                f"({_some(self._bad)}); their time is left out",
            )
            self._bad = []
        return None

    def claims(self) -> tuple[float, int, int]:
        """No rate, the number of pictures, no rotation."""
        return 0.0, len(self.files), 0


def check_output(path: Path, output: Path) -> None:
    """Refuse an output among the pictures of a folder: its plot would be one of them in the next run."""
    if path.is_dir() and output.resolve().parent == path.resolve():
        raise UsageError(
            f"the output {output} would lie among the pictures of {path}", hint="name another folder"
        )


def _listed(path: Path) -> list[Path]:
    """The pictures in order."""
    if path.is_dir():
        files = [f for f in path.iterdir() if f.suffix.lower() in ENDINGS and f.is_file()]
        files = [f for f in files if not f.name.startswith(".")]
        if not files:
            hint = f"it may hold {', '.join(ENDINGS)}"
            raise InputError("is a folder without pictures", file=path, hint=hint)
        series = Counter(re.sub(r"\d+", "#", f.name) for f in files)
        if len(series) > 1:
            found = ", ".join(f"{count} like {name}" for name, count in series.most_common(4))
            raise InputError(
                f"holds several series of pictures: {found}",
                file=path,
                hint="name the one that is the film by a pattern, as in 'folder/frame_%05d.png'",
            )
        return sorted(files, key=lambda f: _numbers(f.name))
    holders = _HOLDER.findall(path.name)
    if len(holders) != 1:
        raise InputError(f"has {len(holders)} place holders; a pattern has one", file=path)
    if not path.parent.is_dir():
        raise InputError("cannot be read: no such folder", file=path, hint="check the path")
    before, after = path.name.split(holders[0])
    width = int(re.sub(r"\D", "", holders[0]) or 0)
    # printf fills up to the width, and writes longer numbers in full.
    digits = rf"(\d{{{width}}}|[1-9]\d{{{width},}})" if width else r"(\d+)"
    name = re.compile(re.escape(before) + digits + re.escape(after))
    matches = [(name.fullmatch(f.name), f) for f in path.parent.iterdir()]
    numbered = [(int(match.group(1)), file) for match, file in matches if match]
    if not numbered:
        raise InputError(
            "no picture has a name like this", file=path, hint="check the pattern, and the folder"
        )
    return [file for _, file in sorted(numbered)]


def _numbers(name: str) -> list[int]:
    return [int(digits) for digits in re.findall(r"\d+", name)]


def _positions(path: Path, files: list[Path]) -> list[int]:
    """Place of each picture in an even series: by the number that counts in the names, else by the order."""
    table = np.array([_numbers(f.name) or [0] for f in files], dtype=object)
    counting = [k for k in range(table.shape[1]) if len(set(table[:, k])) > 1]
    order = list(range(len(files)))
    if len(counting) != 1:
        return order
    numbers = [int(n) for n in table[:, counting[0]]]
    steps = [b - a for a, b in pairwise(numbers)]
    usual = max(Counter(steps).most_common(1)[0][0], 1)
    if any(step < 1 or step % usual for step in steps):
        warn(
            "SWM043",
            f"{path.name}: the numbers in the names of the pictures step unevenly (by {min(steps)} to "
            f"{max(steps)}); the pictures are taken at even steps, in their order",
        )
        return order
    missing = [f"after {files[k].name}" for k, step in enumerate(steps) if step != usual]
    if missing:
        count = sum(step // usual - 1 for step in steps)
        warn(
            "SWM044",
            f"{path.name}: {count} pictures are missing by their numbers ({_some(missing)}); their time is "
            "left out",
        )
    return [(number - numbers[0]) // usual for number in numbers]


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
