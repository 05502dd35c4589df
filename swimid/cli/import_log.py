"""Command ``swimid import``: import of a log, or the draft of its mapping."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from swimid.cli.options import ImportLogOptions
from swimid.errors import UsageError
from swimid.logs import import_log as logs
from swimid.notices import Progress, silent
from swimid.options import takes
from swimid.results import evidence
from swimid.results.result import Result


@takes(ImportLogOptions)
def import_log(
    file: Path,
    *,
    options: ImportLogOptions,
    output: Path | None,
    allow: Callable[[Path | None], object],
    progress: Progress = silent,
) -> Result:
    """Import a file of another program, or draft its mapping.

    Parameters
    ----------
    file : Path
    output : Path
        Log to write; the mapping with ``guess``.
    allow : callable
        Function that is called with every file before it is written. It raises an error if the file must not
        be written.

    Raises
    ------
    UsageError
        If no output is given for a log, or if a mapping is given for the draft of one.
    """
    allow(output)
    if options.guess:
        if options.map_path is not None:
            raise UsageError("--guess drafts a mapping, and takes none")
        from swimid.logs.mapping import guess_mapping

        return guess_mapping(file, select=options.select, output=output)
    if output is None:
        raise UsageError("say where the log goes", hint="add -o run.csv")
    allow(evidence.sidecar(output))
    evidence.check_beside(output)
    return logs.import_log(file, options=options, output=output, progress=progress)
