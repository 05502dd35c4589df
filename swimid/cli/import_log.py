"""``swimid import``: several logs, or a mapping drafted from one."""

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
    """Import files of other programs, or draft the mapping of one.

    Parameters
    ----------
    files : tuple of Path
    output : Path
        A log; a folder for several; the mapping.
    allow : callable
        Called with every file before it is written; raises where that must not be.

    Raises
    ------
    UsageError
        Without an output for a log, and for several files of which one mapping is to be drafted.
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
