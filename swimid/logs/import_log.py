"""``swimid import``: logs of other programs become logs of the pinned format."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.logs import imported, log, mapping
from swimid.logs.examine import examine
from swimid.logs.imported import Imported
from swimid.logs.log import LogLike
from swimid.logs.options import ImportOptions
from swimid.notices import recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results.result import Result


@takes(ImportOptions)
def import_log(
    source: LogLike,
    *,
    options: ImportOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Imported:
    """Make a log in SI units of a foreign recording: rows in order, jumps taken out, the stroke found.

    A mapping, which may be a dict, says which source column becomes which column of the log, and the unit it
    is written in; without one the columns must be named as in the log format. Repeats and jumps are taken out
    of logs with two or more position columns that swimid did not track itself.

    Parameters
    ----------
    source : path, DataFrame or Log
        A file of any format of ``docs/import.md``; or a table, shape (n, k), one row a sample.
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
        The source or the mapping cannot be used; names file, line and column.
    NoTrustworthyResult
        Hardly a sample is left of a track.
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
        # a long file is hashed while it is read
        digests = beside.submit(provenance.digests_of, inputs)
        read = mapping.apply(rules, given, progress=progress)
        found = examine(read, options)
        origin = provenance.collect(
            inputs, settings=options.settings(clean=found.cleaned), digests=digests.result()
        )
        name = f"{found.path.stem}.csv" if output is None else output.name
        result = imported.result(found, name, rules, origin, tuple(notices), progress)
    return result.saved(output)


@takes(ImportOptions)
def import_logs(
    files: Sequence[str | Path],
    *,
    options: ImportOptions,
    output: str | Path,
    progress: Progress = silent,
) -> Result:
    """Write several foreign logs in the log format, each with its evidence, as :func:`import_log` does one.

    Parameters
    ----------
    files : sequence of paths
        At least one.
    output : path
        The log, CSV or Parquet by its ending; for several files a folder, which is made.

    Raises
    ------
    InputError
        A file or the mapping cannot be used.
    NoTrustworthyResult
        Hardly a sample is left of a track.
    UsageError
        No file is named, or two would be written to one.
    """
    if not files:
        raise UsageError("name at least one log to import")
    paths = list(dict.fromkeys(Path(file) for file in files))
    if options.map_path is not None:
        mapping.of(options.map_path)
    done = [
        import_log(path, options=options, output=target, progress=progress)
        for path, target in zip(paths, destinations(paths, Path(output)), strict=True)
    ]
    if len(done) == 1:
        return done[0]
    return Result(
        "import",
        "\n".join(outcome.text for outcome in done),
        {"logs": [outcome.data for outcome in done]},
        [path for outcome in done for path in outcome.outputs],
    )


def destinations(paths: Sequence[Path], output: Path) -> list[Path]:
    """Where each log goes: the file named, or a file in the folder named.

    Raises
    ------
    UsageError
        Several logs and one file to write them to, or two that would have one name.
    """
    if len(paths) == 1 and not output.is_dir() and not str(output).endswith("/"):
        atomic.check_writable(output, inputs=tuple(paths))
        return [output]
    if output.exists() and not output.is_dir():
        text = f"{len(paths)} logs cannot all go to the file {output}"
        raise UsageError(text, hint="name a folder with -o")
    atomic.check_writable(output.parent / "x")
    output.mkdir(exist_ok=True)
    stems = [path.stem for path in paths]
    names = [
        s if stems.count(s) == 1 else f"{p.resolve().parent.name}-{s}"
        for s, p in zip(stems, paths, strict=True)
    ]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise UsageError(f"two logs would be written to {twice}.csv", hint="import them one by one")
    return [atomic.check_writable(output / f"{name}.csv", inputs=tuple(paths)) for name in names]
