"""Scripts that do a run as a job array of Slurm. Other queues use ``--shard K/N`` in the same way."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.files.provenance import is_own
from swimid.results.result import Text

if TYPE_CHECKING:
    from swimid.runs.options import BatchOptions

#: Number of jobs of an array if the user states none.
JOBS = 100

_ARRAY = """#!/bin/bash
# Written by swimid. Submit both scripts with: bash {submit}
#SBATCH --job-name=swimid
#SBATCH --array=1-{jobs}
#SBATCH --cpus-per-task=1
#SBATCH --requeue
#SBATCH --output={logs}/%A_%a.txt
set -e
cd {folder}
# Exit status 4 says that an item was refused or failed, which the summary shows.
swimid batch {plan} -o {run} --shard "$SLURM_ARRAY_TASK_ID/{jobs}" --jobs 1{retry} || [ $? -eq 4 ]
"""
_COLLECT = """#!/bin/bash
# Written by swimid. It runs after the array, and writes summary and page.
#SBATCH --job-name=swimid-collect
#SBATCH --output={logs}/collect.txt
cd {folder}
swimid batch {plan} -o {run} --collect
"""
_SUBMIT = """#!/bin/bash
# Written by swimid.
set -e
job=$(sbatch --parsable {array})
sbatch --dependency=afterany:"$job" {collect}
"""


def write(folder: Path, plan: Path, run: Path, options: BatchOptions, items: int, force: bool) -> Text:
    """Write the scripts ``array.sh``, ``collect.sh`` and ``submit.sh`` of a job array into a folder.

    Each job of the array does a shard of the items. The job after the array writes the summary.
    """
    folder.mkdir(parents=True, exist_ok=True)
    place = folder.resolve()
    jobs = min(options.jobs or JOBS, items)
    scripts = {place / "array.sh": _ARRAY, place / "collect.sh": _COLLECT, place / "submit.sh": _SUBMIT}
    named = {"folder": os.getcwd(), "plan": plan, "run": run, "logs": place}
    named |= {path.stem: path for path in scripts}
    if any(not str(path).isprintable() for path in named.values()):
        raise UsageError(f"a path of the scripts is not printable: {[*map(str, named.values())]}")
    # An absolute path does not begin with a dash, which a command takes for an option.
    named |= {name: path.absolute() for name, path in (("plan", plan), ("run", run)) if str(path)[0] == "-"}
    words = {name: shlex.quote(str(value)) for name, value in named.items()}
    words["retry"] = "".join(f" --retry {shlex.quote(state)}" for state in options.retry)
    with atomic.together():
        for path, text in scripts.items():
            if not force and not is_own(path):
                raise UsageError(f"{path} exists and was not written by swimid", hint="name another folder")
            atomic.write_text(path, text.format(jobs=jobs, **words))
    text = f"{jobs} jobs for {items} items. Submit them: bash {words['submit']}"
    return Text("batch", text, {"jobs": jobs, "items": items}, list(scripts))
