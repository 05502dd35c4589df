"""Scripts that do a run as a job array of Slurm. Other queues use ``--shard K/N`` in the same way."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.files.provenance import is_own
from swimid.files.templates import environment
from swimid.results.result import Text

if TYPE_CHECKING:
    from swimid.runs.options import BatchOptions

#: Number of jobs of an array if the user states none.
JOBS = 100


def write(folder: Path, plan: Path, run: Path, options: BatchOptions, items: int, force: bool) -> Text:
    """Write the scripts ``array.sh``, ``collect.sh`` and ``submit.sh`` of a job array into a folder.

    Each job of the array does a shard of the items. The job after the array writes the summary.
    """
    folder.mkdir(parents=True, exist_ok=True)
    place = folder.resolve()
    jobs = min(options.jobs or JOBS, items)
    scripts = [place / f"{name}.sh" for name in ("array", "collect", "submit")]
    named = {"folder": os.getcwd(), "plan": plan, "run": run, "logs": place}
    named |= {path.stem: path for path in scripts}
    for path in named.values():
        if not str(path).isprintable():
            raise UsageError(f"a path of the scripts has a character that is not printable: {str(path)!r}")
    # An absolute path does not begin with a dash, which a command takes for an option.
    named |= {name: path.absolute() for name, path in (("plan", plan), ("run", run)) if str(path)[0] == "-"}
    words = {name: shlex.quote(str(value)) for name, value in named.items()}
    words["retry"] = "".join(f" --retry {shlex.quote(state)}" for state in options.retry)
    templates = environment("swimid.runs", keep_trailing_newline=True, autoescape=False)
    with atomic.write_together():
        for path in scripts:
            if not force and not is_own(path):
                raise UsageError(f"{path} exists and was not written by swimid", hint="name another folder")
            atomic.write_text(path, templates.get_template(path.name).render(jobs=jobs, **words))
    text = f"{jobs} jobs for {items} items. Submit them: bash {words['submit']}"
    return Text("batch", text, {"jobs": jobs, "items": items}, scripts)
