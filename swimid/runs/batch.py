"""Command ``swimid batch``: run of a plan, which processes the items that are missing or outdated."""

from __future__ import annotations

import json
import os
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from swimid.errors import Interrupted, UsageError
from swimid.files import atomic
from swimid.files.provenance import is_own
from swimid.notices import Progress, show, silent
from swimid.options import takes
from swimid.results.result import Result
from swimid.runs import item, status, summary
from swimid.runs.options import BatchOptions
from swimid.runs.plan import Item, Resolved, folder_of, resolve

#: States of the items that a run processes. Items in the states ``failed`` and ``refused`` are processed only
#: on request.
UNFINISHED = ("missing", "outdated")
#: Exit status of a run in which an item is refused, failed or without result.
INCOMPLETE = 4


class Batch(Result):
    """Result of ``batch``: number of items by state, and the items that need attention.

    Attributes
    ----------
    document : Summary
        Items of the run with their states, verdicts and estimates; None after a dry run.
    exit_status : int
        Exit status of the command: 4 if an item is refused, failed, without result, held by another process
        or not processed; else 0.
    """

    next_step = "python -m webbrowser {file}"

    @property
    def exit_status(self) -> int:
        """Exit status of the command that prints this result."""
        allowed = {"done"}
        if self.data.get("collected"):
            allowed |= {*UNFINISHED}
        if set(self.data.get("states", {})) <= allowed:
            return 0
        return INCOMPLETE


@takes(BatchOptions)
def batch(
    plan: str | Path,
    *,
    output: str | Path,
    options: BatchOptions,
    force: bool = False,
    progress: Progress = silent,
) -> Batch:
    """Process many films, logs or trials files with a sequence of commands.

    Each item is processed in a process of its own, which writes results and state to ``output/items/<name>``.
    An item is not repeated if it is done with the same inputs, options and version of swimid.

    Parameters
    ----------
    plan : path
        Plan file (swimid-plan/1, ``docs/batch.md``).
    output : path
        Folder of the run. It is created if it does not exist.
    force : bool
        Whether the folder may contain files that do not belong to a run.
    progress : Progress

    Returns
    -------
    Result
        ``.document`` is the summary of the run. ``.data`` has the number of items in each state.

    Raises
    ------
    InputError
        If the plan is invalid.
    UsageError
        If the folder is not empty and not that of a run.
    Interrupted
        After Ctrl-C. Repeat the call to continue the run.

    Examples
    --------
    >>> planned = batch("sample_logs/plan.yaml", output="run", dry_run=True)
    >>> [item["id"] for item in planned.data["items"]]
    ['pool_pool.mp4', 'rig_trials.yaml', 'tfish_trials.yaml']
    """
    run = Path(output).resolve()
    if not force:
        _insist_own(Path(output))
    resolved = resolve(Path(plan), run)
    if not force:
        _insist_same(run, resolved)
    mine = resolved.items[options.part]
    if options.dry_run:
        return _list_items(mine, run, options)
    run.mkdir(parents=True, exist_ok=True)
    atomic.write_text(run / "plan.json", resolved.model_dump_json(indent=1) + "\n")
    problems = {}
    if not options.collect:
        problems = _do(run, mine, options, progress)
        _insist_same(run, resolved)
    return _summarise(summary.of_run(resolved, run, problems), mine, Path(output), options)


def _states_of(items: list[Item], run: Path) -> dict[str, str]:
    """Return the state of each item. The key is the name of the item."""
    return {one.id: status.state_of(one, folder_of(run, one.id))[0] for one in items}


def _insist_own(run: Path) -> None:
    """Raise an error if a folder has content and is not the folder of a run."""
    atomic.check_empty(run, force=True)
    plan = run / "plan.json"
    if run.is_dir() and any(run.iterdir()) and not (plan.is_file() and is_own(plan)):
        raise UsageError(
            f"the folder {run} contains files that do not belong to a run",
            hint="name a new folder, or give --force",
        )


def _insist_same(run: Path, resolved: Resolved) -> None:
    """Raise an error if the folder of a run belongs to another plan."""
    try:
        place = json.loads((run / "plan.json").read_bytes()).get("place") or resolved.place
    except (OSError, ValueError, AttributeError):
        return
    if place != resolved.place:
        raise UsageError(
            f"the folder {run} is the run of another plan, {place}",
            hint="name a new folder; if the plan was renamed, give --force",
        )


def _do(run: Path, mine: list[Item], options: BatchOptions, progress: Progress) -> dict[str, str]:
    """Process unfinished items. Return, by item, the errors of items whose status cannot be written."""
    problems: dict[str, str] = {}
    wanted = {*UNFINISHED, *options.retry}
    todo = [name for name, state in _states_of(mine, run).items() if state in wanted]
    if not todo:
        return problems
    item.stopping.clear()
    jobs = options.jobs or os.cpu_count() or 1
    counts: Counter[str] = Counter(before=len(mine) - len(todo))
    try:
        with progress("items", total=len(todo)) as step, ThreadPoolExecutor(jobs) as pool:
            futures = {pool.submit(item.run_item, str(run), ident): ident for ident in todo}
            try:
                for future in as_completed(futures):
                    try:
                        counts[future.result()] += 1
                    except OSError as error:
                        problems[futures[future]] = f"{error}".replace(f"{run}/", "")
                        counts["failed"] += 1
                    show(step, _count_text(counts))
                    step()
            finally:
                if not all(future.done() for future in futures):
                    item.stop()
                    for future in futures:
                        future.cancel()
    except KeyboardInterrupt:
        finished = sum(count for state, count in counts.items() if state not in ("missing", "before"))
        text = f"interrupted; {finished} of {len(todo)} items are finished: the same command continues"
        raise Interrupted(text) from None
    return problems


def _count_text(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {state}" for state, count in counts.items())


def _list_items(mine: list[Item], run: Path, options: BatchOptions) -> Batch:
    """Return the list of items with their states and commands, for a dry run."""
    lines: list[str] = []
    items: list[dict[str, Any]] = []
    shown: set[str] = set()
    states, wanted = _states_of(mine, run), {*UNFINISHED, *options.retry}
    for one in mine:
        state = states[one.id]
        verb = "run" if state in wanted else "keep"
        lines.append(f"{verb:5s} {state:9s} {one.id}")
        items.append({"id": one.id, "state": state, "run": state in wanted, "files": one.files})
        if one.group not in shown:
            shown.add(one.group)
            lines += [f"      $ swimid {' '.join(argv)}" for step in one.steps for argv in step.argv[:1]]
    count = sum(entry["run"] for entry in items)
    text = f"{count} of {len(items)} items would be run."
    lines.append(f"{text} Commands are shown for the first item of each group.")
    return Batch("batch", "\n".join(lines), {"items": items})


def _summarise(found: summary.Summary, mine: list[Item], output: Path, options: BatchOptions) -> Batch:
    """Write the summary of a run, unless it is a shard, and return the result for the terminal."""
    outputs: list[Path] = []
    if options.shard is None:
        summary.write(found, output.resolve())
        outputs = [output / name for name in summary.NAMES]
    names = {one.id for one in mine}
    entries = [entry for entry in found.entries if entry.id in names]
    counts = Counter(entry.state for entry in entries)
    data: dict[str, Any] = {
        "items": len(entries),
        "states": dict(counts),
        "collected": options.collect,
        "entries": [entry.plain() for entry in entries],
    }
    return Batch("batch", summary.text(entries), data, outputs, document=found)
