"""``swimid import``: turn logs of other programs into logs of the pinned format."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.logs import imported, log, mapping
from swimid.logs.examine import Examined, examine
from swimid.logs.log import Log, LogLike
from swimid.logs.logged import Logged
from swimid.logs.options import ImportOptions
from swimid.notices import recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results.result import Result


@dataclass(frozen=True, eq=False)
class Imported(Logged):
    """A log of another program in the log format, as ``import_log`` returns it.

    Attributes
    ----------
    examined : Examined
        Rows in order, jumps and speed of the track, and the stroke; None for a result read from a file.
    progress : Progress
        Shows the writing.
    """

    examined: Examined | None = None
    progress: Progress = field(default=silent, repr=False)

    def _write(self, path: Path) -> list[Path]:
        with self.progress(f"writing {path.name}", total=len(self.log)) as step:
            log.write_numbers(path, self.log.columns, self.log.metadata, step=step)
        return [path]


@takes(ImportOptions)
def import_log(
    source: LogLike,
    *,
    options: ImportOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Imported:
    """Turn a foreign recording into a log in SI units, with its rows in order and its jumps removed.

    A profile reads a file of a known format. For any other file a mapping, which may be a dict, says which
    source column becomes which column of the log, and in which unit it was written; without one the columns
    must be named as in the log format. Repeats and jumps are removed from logs with two or more position
    columns, except from tracks made by swimid.

    Parameters
    ----------
    source : path, DataFrame or Log
        A file of any format in ``docs/import.md``; or a table, shape (n, k), one row a sample.
    output : path, optional
        The log, CSV or Parquet by its ending, with ``<stem>.evidence.json`` beside it. Without it nothing is
        written; :meth:`~swimid.results.result.Result.save` writes the same later.
    progress : Progress
        Shows reading and writing.

    Returns
    -------
    Imported
        ``.log`` and ``.frame`` the columns, each shape (n,), SI; ``.examined`` the speed (m/s), stroke (Hz)
        and jumps found; ``.checks()``, ``.figures()``.

    Raises
    ------
    InputError
        The source or the mapping cannot be used, or states no time; names file, line and column.
    NoTrustworthyResult
        A cleaned track has hardly a sample left.
    UsageError
        The output is the source.

    References
    ----------
    Pearson et al. (2016), doi:10.1186/s13634-016-0383-6, for the jumps; Craven and Wahba (1979),
    doi:10.1007/BF01404567, for the speed along the path.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> ms = 20.0 * np.arange(400)
    >>> heading = 10 * np.sin(2 * np.pi * 1.5 * ms / 1000)
    >>> table = pd.DataFrame({"Time": ms, "Heading": heading})
    >>> columns = [{"source": "Heading", "target": "yaw_rad", "unit": "deg"}]
    >>> made = import_log(table, map_path={"time": {"source": "Time", "unit": "ms"}, "columns": columns})
    >>> list(made.frame), round(made.data["stroke"]["frequency_hz"], 3)
    (['t_s', 'yaw_rad'], 1.5)
    """
    given, map_path = log.unread(source), options.map_path
    rules = None if map_path is None else mapping.of(map_path)
    inputs: list[provenance.Input] = [given]
    if rules is not None:
        inputs.append(map_path if isinstance(map_path, str | Path) else rules)
    if output is not None:
        output = atomic.check_writable(output, inputs=inputs)
    with recorded(repeat=True) as notices, ThreadPoolExecutor(1) as beside:
        # hash a long file while it is read
        digests = beside.submit(provenance.digests_of, inputs)
        read = mapping.apply(rules, given, options.stated, progress=progress)
        found = examine(read, options)
        settings = options.settings(clean=found.cleaned)
        origin = provenance.collect(inputs, settings=settings, digests=digests.result())
        name = f"{found.path.stem}.csv" if output is None else output.name
        made = Log(Path(name), found.metadata, found.columns, None)
        proof = imported.build(found, origin, notices)
    data = imported.data(found, proof)
    result = Imported("import", "", data, evidence=proof, document=made, examined=found, progress=progress)
    return result.saved(output)


@takes(ImportOptions)
def import_logs(
    files: Sequence[str | Path],
    *,
    options: ImportOptions,
    output: str | Path,
    progress: Progress = silent,
) -> Result:
    """Import several foreign logs, each as :func:`import_log` does.

    A file that cannot be imported does not stop the others.

    Parameters
    ----------
    files : sequence of paths
        At least one.
    output : path
        The log, CSV or Parquet by its ending; for several files a folder, which is made.

    Raises
    ------
    InputError
        The mapping cannot be used; or, after all other files were imported, files that could not be.
    NoTrustworthyResult
        The only file is a track with hardly a sample left.
    UsageError
        No file is named, or two would be written to one.
    """
    if not files:
        raise UsageError("name at least one log to import")
    paths = list(dict.fromkeys(Path(file) for file in files))
    if options.map_path is not None:
        mapping.of(options.map_path)  # refuse it before any file is read
    done: list[Imported] = []
    failed: list[InputError | NoTrustworthyResult] = []
    for path, target in zip(paths, destinations(paths, Path(output)), strict=True):
        try:
            done.append(import_log(path, options=options, output=target, progress=progress))
        except (InputError, NoTrustworthyResult) as error:
            if len(paths) == 1:
                raise
            failed.append(error)
    if failed:
        listed = "\n  ".join(f"{error}" + (f" ({error.hint})" if error.hint else "") for error in failed)
        written = ", ".join(str(outcome.outputs[0]) for outcome in done) or "none"
        text = f"{len(failed)} of {len(paths)} logs cannot be imported:\n  {listed}"
        raise InputError(text, hint=f"the others were written: {written}")
    if len(done) == 1:
        return done[0]
    text = "\n\n".join(outcome.summary() for outcome in done)
    outputs = [path for outcome in done for path in outcome.outputs]
    return Result("import", text, {"logs": [outcome.data for outcome in done]}, outputs)


def destinations(paths: Sequence[Path], output: Path) -> list[Path]:
    """Return where each log goes: the file that was named, or a file in the folder that was named.

    Raises
    ------
    UsageError
        There are several logs and one file to write them to, or two would have one name.
    """
    if len(paths) == 1 and not output.is_dir() and not str(output).endswith("/"):
        atomic.check_writable(output, inputs=tuple(paths))
        return [output]
    if output.exists() and not output.is_dir():
        text = f"{len(paths)} logs cannot all go to the file {output}"
        raise UsageError(text, hint="name a folder with -o")
    atomic.check_writable(output.parent / "x")
    output.mkdir(exist_ok=True)
    stems = Counter(path.stem for path in paths)
    names = [
        path.stem if stems[path.stem] == 1 else f"{path.resolve().parent.name}-{path.stem}" for path in paths
    ]
    # some file systems ignore capitals
    folded = Counter(name.casefold() for name in names)
    twice = [name for name in names if folded[name.casefold()] > 1]
    if twice:
        raise UsageError(f"two logs would be written to {twice[0]}.csv", hint="import them one by one")
    return [atomic.check_writable(output / f"{name}.csv", inputs=tuple(paths)) for name in names]
