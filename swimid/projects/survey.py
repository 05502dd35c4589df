"""Survey of a folder: which of its files are films, logs, tables of tracked points, or files of swimid."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from swimid.errors import InputError
from swimid.imports.formats import formats, open_table
from swimid.imports.table import Peek, is_text
from swimid.logs import log
from swimid.logs.experiments import Trials
from swimid.notices import Progress, record_warnings, silent
from swimid.points.point_files import find_tracked_points
from swimid.tracking.frames import PICTURE_EXTENSIONS as PICTURES
from swimid.tracking.frames import Video

#: File name extensions of films. FFmpeg decodes all of these formats.
FILMS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".wmv", ".mts", ".mjpeg", ".mj2")
#: File name extensions of tables, in addition to those of the formats that can be read.
TABLES = (".tsv", ".tdms", ".c3d", ".lvm", ".nc", ".json", ".trc", ".mot", ".sto", ".kva", ".bin", "")
#: Pattern of the names of files that swimid or an editor writes beside other files. These files are ignored.
SIDE_FILES = re.compile(r".*(\.evidence\.json|\.partial|\.lock|\.markers\.png|~)|\..*|__pycache__")
#: Minimum number of pictures with numbers in their names that count as a film.
MIN_PICTURES = 10
#: Minimum number of rows of a table that counts as a recording.
MIN_ROWS = 10


@dataclass(frozen=True)
class SurveyedFile:
    """File, or folder of pictures, with its kind and description.

    Attributes
    ----------
    kind : str
        ``film``, ``log`` (in the log format), ``points`` (of a tracker), ``table``, ``notes`` (a table that
        names recordings), ``choice`` (several topics), ``swimid`` (a YAML file of swimid),
        ``damaged`` or ``other``.
    about : str
        Content in words, or the reason why it cannot be read.
    alike : tuple
        Values that describe how a recording was made. Recordings with equal values form a group.
    columns : tuple of str
        Names of the columns of a table.
    rate_hz : float
        Frame rate that a film states; 0 if it states none.
    rows : int
        Number of rows of a table, or of frames that a film states.
    has_times : bool
        Whether the rows of a table have times.
    profile : str
        Name of the format of a table with a profile; empty otherwise.
    is_alone : bool
        Whether the file is the table of a whole experiment. Its kind is then the name of the experiment.
    """

    path: Path
    kind: str
    about: str
    alike: tuple[Any, ...] = ()
    columns: tuple[str, ...] = ()
    rate_hz: float = 0.0
    rows: int = 0
    has_times: bool = False
    profile: str = ""
    is_alone: bool = False
    metadata: dict[str, Any] = field(default_factory=dict, compare=False)
    #: Rows of a small table as text, by column.
    cells: dict[str, list[str]] = field(default_factory=dict, compare=False)


def survey(
    folder: Path,
    kinds: Mapping[str, type[Trials]],
    left_out: Path | None = None,
    progress: Progress = silent,
) -> list[SurveyedFile]:
    """Return the recordings of a folder and of its subfolders, in the order of their names.

    Parameters
    ----------
    folder : Path
    kinds : mapping of str to class
        Experiments by name, of which some have one table instead of logs.
    left_out : Path, optional
        Folder that is ignored, which is the folder of the project.

    Raises
    ------
    InputError
        The folder does not exist, or holds no file.
    """
    if not folder.is_dir():
        raise InputError("is no folder", file=folder, hint="name the folder of your recordings")
    paths = list(_paths(folder, left_out and left_out.resolve()))
    if not paths:
        raise InputError("holds no file", file=folder, hint="name the folder of your recordings")
    found = []
    with progress("looking", total=len(paths)) as step, record_warnings():
        for path in paths:
            found.append(recognise(path, kinds))
            step()
    names = {name for one in found for name in (one.path.name, one.path.stem) if one.kind != "notes"}
    return [_with_role(one, names) for one in found]


def _paths(folder: Path, left_out: Path | None) -> Iterator[Path]:
    """Yield the files below a folder, and the folders that hold the numbered pictures of a film."""
    for root, folders, files in os.walk(folder):
        here = Path(root)
        others = [one for one in folders if not SIDE_FILES.fullmatch(one)]
        folders[:] = sorted(one for one in others if (here / one).resolve() != left_out)
        numbered = [name for name in files if re.search(r"\d", name) and name.lower().endswith(PICTURES)]
        if len(numbered) >= MIN_PICTURES and here != folder:
            yield here
            files = [name for name in files if name not in numbered]
        yield from (here / name for name in sorted(files) if not SIDE_FILES.fullmatch(name))


def recognise(path: Path, kinds: Mapping[str, type[Trials]]) -> SurveyedFile:
    """Return the kind and the description of a file or a folder of pictures."""
    ending = path.suffix.lower()
    readable = {end for form in formats().values() for end in form.endings} | {*TABLES}
    try:
        if path.is_dir() or ending in FILMS:
            return _film(path)
        if ending in (".yaml", ".yml"):
            form = re.search(r"^format: (swimid-\S+)", "\n".join(Peek.of(path).lines), re.M)
            if form is not None:
                return SurveyedFile(path, "swimid", form[1])
        elif ending in readable:
            return _table(path, kinds)
    except InputError as error:
        if several(error):
            return SurveyedFile(path, "choice", f"{error.reason}. {error.hint}")
        # A text without rows of numbers, such as a licence, does not count as a damaged recording.
        kind = "other" if ending in (".txt", "") else "damaged"
        return SurveyedFile(path, kind, error.reason)
    return SurveyedFile(path, "other", "no recording")


def several(error: InputError) -> bool:
    """Return whether a file could not be read because the user must choose one of its topics or tracks."""
    return "; name one" in error.message


def _film(path: Path) -> SurveyedFile:
    video = Video(path)
    size = f"{video.width} x {video.height} px"
    rate = round(video.stated_rate_hz, 2)
    about = f"{size}, {video.claimed} frames"
    if rate:
        about += f" at {rate:g} Hz"
    return SurveyedFile(path, "film", about, ("film", size, rate), rate_hz=rate, rows=video.claimed)


def _table(path: Path, kinds: Mapping[str, type[Trials]]) -> SurveyedFile:
    table = open_table(path, kind="")
    kind, is_alone = "table", False
    columns = tuple(table.columns)
    points = find_tracked_points(table.columns)
    title = formats()[table.profile].title if table.profile else "table"
    rows = max(map(len, table.columns.values()))
    about = f"{title}, {rows} rows"
    if table.profile == "swimid":
        kind = "log"
    elif points and table.profile:
        kind, about = "points", f"{about}, points {', '.join(points)}"
    else:
        for name, experiment in kinds.items():
            if experiment.entry is None and experiment.has_columns(columns):
                title = experiment.about.partition(";")[0]
                kind, about, is_alone = name, f"{title}, {rows} runs", True
    metadata = table.metadata
    if kind == "log":
        metadata = log.metadata_of(table.comments, path, strict=False)
    cells = {}
    if kind == "table" and any(map(is_text, table.columns.values())):
        cells = {name: [str(cell) for cell in values[:10_000]] for name, values in table.columns.items()}
    alike = (kind, table.profile, columns, tuple(table.units.items()), metadata.get("experiment"))
    return SurveyedFile(
        path, kind, about, alike, columns, rows=rows, has_times=log.TIME in columns, profile=table.profile,
        metadata=metadata, cells=cells, is_alone=is_alone,
    )  # fmt: skip


def _with_role(one: SurveyedFile, names: set[str]) -> SurveyedFile:
    """Return a table with the kind ``notes`` if all cells of one of its columns name recordings.

    Any other table with few rows does not count as a recording.
    """
    for name, cells in one.cells.items():
        if cells and all(cell in names for cell in cells):
            about = f"table of {len(cells)} recordings, named in its column '{name}'"
            return SurveyedFile(one.path, "notes", about, columns=(name, *one.columns), cells=one.cells)
    if one.kind == "table" and one.rows < MIN_ROWS:
        return SurveyedFile(one.path, "other", f"{one.about}, too few for a recording")
    return one
