"""Command ``swimid sample``: copies of the sample recordings of the installed version."""

from __future__ import annotations

import shlex
import shutil
import textwrap
from pathlib import Path

from swimid.errors import InputError, UsageError, suggestion
from swimid.files import atomic, download, yamlio
from swimid.notices import Progress, silent
from swimid.options import takes
from swimid.projects.options import SampleOptions
from swimid.results.result import WIDTH, Result

#: File that lists the samples, and name by which all of them are copied.
INDEX, ALL = "samples.yaml", "all"
#: File of a sample that lists the recordings to download.
DOWNLOAD = "download.yaml"
#: Folder of the samples in an installed package, and in the source.
SAMPLE_FOLDERS = (Path(__file__).parents[1] / "sample_logs", Path(__file__).parents[2] / "sample_logs")


class Sample(Result):
    """Result of ``sample``. Its ``data`` has folder and next command of a sample, or a list of samples."""

    def next_command(self, file: str | Path, folder: Path = Path()) -> str:
        """Return the command for the copied sample, or the command that copies the first sample."""
        return str(self.data.get("command", "swimid sample rig"))


@takes(SampleOptions)
def sample(
    name: str | None = None,
    *,
    options: SampleOptions,
    output: Path | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> Sample:
    """Copy a sample to a folder, or list the samples. ``all`` excludes samples that must be downloaded.

    Parameters
    ----------
    name : str, optional
        Name of the sample. Without a name, nothing is copied.
    output : path, optional
        Folder for the copy, by default a folder in the working folder with the name of the sample.
    force : bool
        Whether the folder may have content. Files of the same names are replaced.
    progress : Progress
        Progress display of the download.

    Returns
    -------
    Result
        ``.outputs`` are the copied files.

    Raises
    ------
    UsageError
        There is no such sample, the folder has content, or nothing of the sample is downloaded.
    InputError
        The samples are not installed, the folder cannot be written, or a recording cannot be downloaded.

    Examples
    --------
    >>> list(sample().data["samples"])[:3]
    ['rig', 'cruise', 'tfish']
    """
    source = _find_samples()
    index = yamlio.plain(yamlio.load(source / INDEX))
    if name is None:
        return _list_samples(index)
    if name not in index:
        raise UsageError(f"there is no sample '{name}'", hint=suggestion(name, list(index)))
    folder = Path(name) if output is None else output
    atomic.check_empty(folder, force=force)
    described = source / name / DOWNLOAD
    if options.address is not None and not described.is_file():
        raise UsageError(f"the files of the sample '{name}' are installed: omit --from")
    copies: list[Path] = []
    with atomic.write_together():
        atomic.make_folder(folder)
        if described.is_file():
            copies += download.fetch(described, folder, address=options.address, progress=progress)
        copies += _copy(source if name == ALL else source / name, folder, everything=name == ALL)
    about = index[name]["about"]
    command = " ".join(index[name]["command"].split()).format(folder=shlex.quote(folder.as_posix()))
    data = {"sample": name, "folder": str(folder), "about": about, "command": command}
    return Sample("sample", f"{folder}: {about}", data, copies)


def _find_samples() -> Path:
    """Return the folder of the samples."""
    for folder in SAMPLE_FOLDERS:
        if folder.is_dir():
            return folder
    raise InputError("the samples are not part of this installation", hint="reinstall swimid")


def _list_samples(index: dict[str, dict[str, str]]) -> Sample:
    width = max(map(len, index))
    start = {name: f"  {name:{width}}  " for name in index}
    wrap = textwrap.TextWrapper(WIDTH, subsequent_indent=" " * (width + 4), break_on_hyphens=False)
    lines = [wrap.fill(start[name] + entry["about"]) for name, entry in index.items()]
    return Sample("sample", "\n".join(lines), {"samples": index})


def _copy(origin: Path, folder: Path, *, everything: bool) -> list[Path]:
    """Copy a sample, or all samples without downloads, to a folder; return the paths of the copies."""
    copies = []
    for path in sorted(origin.rglob("*")):
        copy = folder / path.relative_to(origin)
        if everything and any((place / DOWNLOAD).is_file() for place in (path, *path.parents)):
            continue
        if path.is_dir():
            atomic.make_folder(copy)
        elif path.name not in (INDEX, DOWNLOAD):
            with atomic.replace_file(copy) as temporary:
                shutil.copyfile(path, temporary)
            copies.append(copy)
    return copies
