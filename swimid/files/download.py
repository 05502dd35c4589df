"""Download of public files from a stated commit of a repository, with a check of their SHA-256.

A YAML file lists the files of a dataset (:class:`RemoteFiles`)::

    format: swimid-download/1
    repository: owner/name
    commit: 0123456789abcdef0123456789abcdef01234567
    licence: MIT
    licence_text: |
      MIT License ...
    citation: "Authors: Title. Journal, year."
    about: Points of a fish robot that were tracked in eight films.
    root: Data/Markers
    files:
      Data/Markers/a.csv: <SHA-256>

A file is written under its path below ``root``, and under its name alone if it is not below ``root``.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from swimid.errors import InputError, file_errors, first_line
from swimid.files import atomic, yamlio
from swimid.files.provenance import sha256
from swimid.notices import Progress, silent, warn

#: Default address of the server. The path of a file below this address is ``owner/name/commit/path``.
ADDRESS = "https://raw.githubusercontent.com"
#: Environment variable that states another server or a local folder as the source of downloads.
VARIABLE = "SWIMID_DOWNLOADS"
#: Maximum time to wait for an answer of a server, s.
SERVER_TIMEOUT_S = 30
#: Names of the files that are written to the folder of the downloaded files.
LICENCE, CITATION = "LICENSE", "CITATION.md"


class RemoteFiles(yamlio.Document):
    """Public files of one commit of a repository.

    Attributes
    ----------
    repository : str
        Owner and name on GitHub.
    commit : str
        Commit that has the files, 40 hexadecimal digits.
    licence, licence_text : str
        Name and text of the licence of the files.
    citation, about : str
        Publication to cite, and content of the files.
    root : str
        Folder of the repository that is left out of the local paths.
    files : dict
        SHA-256 of each file, in hexadecimal digits, by its path in the repository.
    """

    format: Literal["swimid-download/1"]
    repository: Annotated[str, StringConstraints(pattern=r"^[\w.-]+/[\w.-]+$")]
    commit: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{40}$")]
    licence: str
    licence_text: str
    citation: str
    about: str
    root: str = ""
    files: Annotated[
        dict[str, Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]], Field(min_length=1)
    ]

    @model_validator(mode="after")
    def _different_names(self) -> Self:
        for path in self.files:
            if path.startswith("/") or "\\" in path or ".." in PurePosixPath(path).parts:
                raise ValueError(f"'{path}' is no path inside a repository")
        names = [self.local(path) for path in self.files]
        if len({*names, LICENCE, CITATION}) < len(names) + 2:
            raise ValueError(f"two files have one local name, or a file is named {LICENCE} or {CITATION}")
        return self

    def local(self, path: str) -> str:
        """Return the path of a repository file in the local folder to which the files are downloaded."""
        whole = PurePosixPath(path)
        if self.root and whole.is_relative_to(self.root):
            return whole.relative_to(self.root).as_posix()
        return path if not self.root else whole.name

    def places(self, path: str) -> list[str]:
        """Return the possible paths of a file below an address, the longest path first."""
        whole = f"{self.repository}/{self.commit}/{path}"
        return list(dict.fromkeys([whole, path, self.local(path), PurePosixPath(path).name]))


def fetch(
    dataset: RemoteFiles | str | Path,
    folder: Path,
    *,
    address: str | None = None,
    progress: Progress = silent,
) -> list[Path]:
    """Copy all files of a dataset, with its licence and citation, to a folder. After an error, copy none.

    The SHA-256 of every file is checked.

    Parameters
    ----------
    dataset : RemoteFiles or path
        List of the files, or the YAML file that has it.
    folder : path
        Folder for the files. It is created if it does not exist.
    address : str, optional
        Address of a server or path of a folder. The default is the environment variable
        ``SWIMID_DOWNLOADS`` or, if it is not set, GitHub. At this address a file has the path
        ``owner/name/commit/path``, ``path``, or its name alone. Files that a folder lacks are left out, with
        warning SWM178.

    Returns
    -------
    list of Path
        The written files.

    Raises
    ------
    InputError
        If the server does not answer or has no such file, if the folder has none of the files, or if the
        SHA-256 of a file differs from the stated SHA-256.
    """
    if not isinstance(dataset, RemoteFiles):
        dataset = yamlio.read_document(dataset, RemoteFiles)
    source = address or os.environ.get(VARIABLE) or ADDRESS
    with tempfile.TemporaryDirectory() as scratch, progress("downloading", total=len(dataset.files)) as step:
        files: dict[str, Path] = {}
        for number, path in enumerate(dataset.files):
            file = Path(scratch) / str(number)
            if _get(dataset, path, source, file):
                files[dataset.local(path)] = file
            step()
        missing = [name for name in map(dataset.local, dataset.files) if name not in files]
        if not files:
            raise InputError(
                f"the folder has none of the files {', '.join(missing)}",
                file=source,
                hint="name the folder that has them, or leave --from out to download them",
            )
        if missing:
            warn("SWM178", f"{source} has no {', '.join(missing)}: these files are left out")
        return _write(dataset, files, folder)


def _get(dataset: RemoteFiles, path: str, source: str, file: Path) -> bool:
    """Copy one dataset file to a temporary path, check its SHA-256, and return whether the source has it."""
    if "://" in source:
        origin = _from_server(dataset, path, source, file)
    else:
        there = _from_folder(dataset, path, Path(source))
        if there is None:
            return False
        with file_errors(there, noted=False):
            shutil.copyfile(there, file)
        origin = str(there)
    if (actual := sha256(file)) != dataset.files[path]:
        raise InputError(
            f"has SHA-256 {actual} instead of {dataset.files[path]}",
            file=origin,
            hint=f"get the file {path} of {dataset.repository} at {dataset.commit} again",
        )
    return True


def _from_server(dataset: RemoteFiles, path: str, source: str, file: Path) -> str:
    """Download one file to a temporary path, and return the address from which it was downloaded."""
    import pooch
    import requests

    places = dataset.places(path)
    if source == ADDRESS:
        places = places[:1]
    for place in places:
        url = f"{source.rstrip('/')}/{place}"
        try:
            pooch.HTTPDownloader(timeout=SERVER_TIMEOUT_S)(url, str(file), None)
        except requests.HTTPError as error:
            if error.response.status_code == requests.codes.not_found and place != places[-1]:
                continue
            raise InputError(
                f"cannot be downloaded: {first_line(error)}",
                file=url,
                hint="check the address, or name a folder that has the files: --from FOLDER",
            ) from error
        except (requests.RequestException, OSError, ValueError) as error:
            raise InputError(
                "cannot be downloaded: the server cannot be reached or does not answer",
                file=url,
                hint=f"download the files of https://github.com/{dataset.repository}/tree/{dataset.commit}"
                " on another machine, and name their folder: --from FOLDER",
            ) from error
        return url
    raise AssertionError("a file has at least one place")


def _from_folder(dataset: RemoteFiles, path: str, source: Path) -> Path | None:
    """Return the path of a dataset file in a local folder; None if the folder lacks the file."""
    if not source.is_dir():
        raise InputError("is no folder and no address", file=source, hint="name a folder, or a URL with http")
    there = (source / place for place in dataset.places(path))
    return next((file for file in there if file.is_file()), None)


def _write(dataset: RemoteFiles, found: dict[str, Path], folder: Path) -> list[Path]:
    """Write downloaded files, licence and citation to a folder, all or none; return the written paths."""
    page = [
        f"# Source of the files\n\n{dataset.about.strip()}\n",
        f"- Source: https://github.com/{dataset.repository}/tree/{dataset.commit}",
        f"- Licence: {dataset.licence}, in {LICENCE}",
        f"- To cite: {dataset.citation.strip()}\n",
        "| file | in the repository | SHA-256 |\n|---|---|---|",
        *(
            f"| {dataset.local(path)} | {path} | `{digest}` |"
            for path, digest in dataset.files.items()
            if dataset.local(path) in found
        ),
    ]
    written = []
    with atomic.write_together():
        atomic.make_folder(folder)
        for name, file in found.items():
            target = folder / name
            for parent in reversed(PurePosixPath(name).parents[:-1]):
                atomic.make_folder(folder / parent)
            with atomic.replace_file(target) as temporary:
                shutil.copyfile(file, temporary)
            written.append(target)
        for name, text in ((LICENCE, dataset.licence_text), (CITATION, "\n".join(page) + "\n")):
            atomic.write_text(folder / name, text)
            written.append(folder / name)
    return written
