"""Command ``swimid import``: import of logs, or the draft of a mapping for one file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from swimid.cli.options import ImportLogOptions
from swimid.errors import UsageError
from swimid.logs.import_log import destinations, import_logs
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import evidence
from swimid.results.result import Result


@takes(ImportLogOptions)
def import_log(
    files: tuple[Path, ...],
    *,
    options: ImportLogOptions,
    output: Path | None,
    allow: Callable[[Path | None], object],
    progress: Progress = silent,
) -> Result:
    """Import files of other programs, or draft the mapping of one file.

    Parameters
    ----------
    files : tuple of Path
    output : Path
        Log to write; a folder for several logs; the mapping with ``guess``.
    allow : callable
        Function that is called with every file before it is written. It raises an error if the file must not
        be written.

    Raises
    ------
    UsageError
        If no output is given for a log, or if several files are given for the draft of a mapping.
    """
    if options.guess:
        if len(files) > 1 or options.map_path is not None:
            raise UsageError("--guess drafts the mapping of one file")
        from swimid.logs.guess_mapping import guess_mapping

        allow(output)
        return guess_mapping(files[0], select=options.select, output=output)
    if output is None:
        raise UsageError("say where the log goes", hint="add -o run.csv")
    for target in destinations(files, output):
        allow(target)
        allow(evidence.sidecar(target))
        evidence.check_beside(target)
    return import_logs(files, options=options, output=output, progress=progress)
