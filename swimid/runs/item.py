"""Processing of one item of a batch in a process of its own.

:func:`run_item` starts the process, and records the failure of an item. The started process runs this module
as a program.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import redirect_stdout, suppress
from pathlib import Path
from typing import Any

import swimid
from swimid import reading
from swimid.errors import UsageError
from swimid.files import atomic
from swimid.results import evidence as ev
from swimid.runs import status as states
from swimid.runs.plan import TRIALS, Item, ItemStep, folder_of, is_linked, item_of
from swimid.runs.status import LOG, STAMPS, STATUS_FILE, Status, StepStatus

#: Exit status of the process of an item that another process holds (EX_TEMPFAIL), and exit status after
#: Ctrl-C.
BUSY, INTERRUPTED = 75, 130
#: Number of bytes at the end of the log of an item that are kept, and number of its lines in an error
#: message.
MAX_LOG, MAX_LINES = 100_000, 15
#: Environment variables of the process of an item, with which each library uses one thread.
ONE_THREAD = dict.fromkeys(
    [f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")] + ["OPENCV_FOR_THREADS_NUM"], "1"
)
#: Extensions of checkpoint and lock files, which are not removed when an item is repeated.
KEPT_ENDINGS = (".partial", ".lock")

#: Event that is set when the run is interrupted, so that no further item is started or repeated.
stopping = threading.Event()
_processes: set[subprocess.Popen[bytes]] = set()


def stop() -> None:
    """End the processing of all items in this process, and start no other item."""
    stopping.set()
    for process in list(_processes):
        process.kill()


def run_item(run: str, ident: str) -> str:
    """Process one item of a run, and return the new state of the item.

    An item that crashes or exceeds its time limit is ``failed``, and its status has the end of its log. An
    item whose folder is a symbolic link is not processed.

    Parameters
    ----------
    run : str
        Folder of the run, with ``plan.json``.
    ident : str
        Name of the item.

    Raises
    ------
    OSError
        If the folder of the item cannot be written.
    """
    item, limits = item_of(run, ident)
    folder = folder_of(Path(run), ident)
    if is_linked(folder):
        return "failed"
    folder.mkdir(parents=True, exist_ok=True)
    if stopping.is_set():
        return "missing"
    code, log = _process(folder, run, ident, limits.time_s)
    if code == BUSY:
        return "busy"
    if stopping.is_set() or code == INTERRUPTED:
        return "missing"
    (folder / LOG).write_text(log, encoding="utf-8")
    status = states.read(folder)
    if code == 0 and status is not None:
        return status.state
    message = f"the command ended with exit status {code}"
    if code is None:
        message = f"the command took longer than the limit of {limits.time_s:g} s"
    elif code < 0:
        with suppress(ValueError):
            message = f"the signal {signal.Signals(-code).name} ended the command"
    error = {"type": "Failed", "message": message, "log": "\n".join(log.splitlines()[-MAX_LINES:])}
    with reading.record():
        _status(item, folder, "failed", [], error).write(folder)
    return "failed"


def _process(folder: Path, run: str, ident: str, limit_s: float) -> tuple[int | None, str]:
    """Process an item in a new process. Return its exit status and the last lines of its log.

    The exit status is None if the item took longer than its time limit. Locks that the process leaves are
    removed.
    """
    command = [sys.executable, "-m", "swimid.runs.item", str(Path(run).resolve()), ident]
    package = str(Path(swimid.__file__).parents[1])
    paths = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # The process ends when this pipe closes, also if this process is killed.
            stdout=log,
            stderr=log,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": paths},
            start_new_session=True,
        )
        _processes.add(process)
        code: int | None = None
        try:
            code = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            pass
        finally:
            process.kill()
            process.wait()
            _processes.discard(process)
            if process.stdin is not None:
                process.stdin.close()
            for lock in folder.glob("*.lock"):
                if not atomic.holder_of(lock):
                    lock.unlink(missing_ok=True)
        log.seek(max(log.seek(0, os.SEEK_END) - MAX_LOG, 0))
        return code, reading.remove_folders(log.read().decode("utf-8", "replace"))


def _status(
    item: Item,
    folder: Path,
    state: Any,
    steps: list[StepStatus],
    error: dict[str, Any],
    sketch: states.Sketch | None = None,
) -> Status:
    files = [path for path in folder.iterdir() if path.is_file() and path.suffix not in KEPT_ENDINGS]
    outputs = [
        path.name for path in files if path.name not in (STATUS_FILE, STAMPS, LOG) and path.name[0] != "."
    ]
    return Status(
        id=item.id,
        state=state,
        version=swimid.__version__,
        steps_sha256=item.digest(),
        inputs={name: opened.digest()[0] for name, opened in _read(item, folder).items()},
        outputs={name: reading.digest_of([folder / name]) for name in sorted(outputs)},
        steps=steps,
        error=error,
        sketch=sketch,
    )


def _read(item: Item, folder: Path) -> dict[str, reading.Opened]:
    """Return the inputs of an item and the files that its steps have read, as they were when read.

    The key is the path relative to the folder of the item. Files in this folder and files of swimid are left
    out.
    """
    for name in item.inputs:
        reading.note(folder / name, at_once=True)
    own = tuple(f"{place}{os.sep}" for place in (folder, Path(swimid.__file__).parent))
    names = {path: Path(os.path.relpath(path, folder)).as_posix() for path in sorted(reading.list_files())}
    return {
        name: reading.list_files()[path]
        for path, name in names.items()
        if name in item.inputs or (os.path.isfile(path) and not path.startswith(own))
    }


# ---------------------------------------------------------------- process of an item


def _main(run: str, ident: str) -> int:
    item, _ = item_of(run, ident)
    folder = folder_of(Path(run), ident)
    os.chdir(folder)
    try:
        with atomic.hold_lock(folder / STATUS_FILE), reading.record():
            for path in folder.iterdir():
                if path.is_dir() and not path.is_symlink() and path.suffix not in KEPT_ENDINGS:
                    shutil.rmtree(path)
                elif path.suffix not in KEPT_ENDINGS:
                    path.unlink()
            _read(item, folder)
            status = _run_steps(item, folder)
            if status is None:
                return INTERRUPTED
            stamps = {name: opened.stamp for name, opened in _read(item, folder).items()}
            atomic.write_text(folder / STAMPS, json.dumps(stamps, indent=1) + "\n")
            status.write(folder)
    except UsageError as error:
        if "is being written by" not in str(error):
            raise
        print(error, file=sys.stderr)
        return BUSY
    return 0


def _run_steps(item: Item, folder: Path) -> Status | None:
    """Run the steps of an item, and return its status; None after Ctrl-C."""
    steps: list[StepStatus] = []
    state = "done"
    error: dict[str, Any] = {}
    sketch: states.Sketch | None = None
    for step in item.steps:
        if step.command == TRIALS:
            atomic.write_text(folder / step.outputs[0], step.text)
            continue
        shown, sketched, code, error = _step(step)
        if code == INTERRUPTED:
            return None
        if code == 1:
            raise RuntimeError(error["message"])
        if code == 0:
            steps.append(shown)
            sketch = sketch or sketched
            continue
        state = {4: "no result"}.get(code, "refused")
        if "cannot be written" in error.get("message", ""):  # The disk may be full: do not blame the input.
            state = "failed"
        if error.get("type") == "NotEnoughMemory":
            state = "failed"
        error["step"] = step.name
        break
    return _status(item, folder, state, steps, error, sketch)


def _step(step: ItemStep) -> tuple[StepStatus, states.Sketch | None, int, dict[str, Any]]:
    """Run the command lines of a step. Return its status, figure sketch, exit status and error."""
    shown, sketch = StepStatus(name=step.name), None
    for argv, output in zip(step.argv, step.outputs, strict=True):
        code, answer = _command(argv)
        if code:
            return shown, None, code, answer.get("error", {})
        if ev.sidecar(output).is_file():
            evidence = ev.read(ev.sidecar(output))
            if states.VERDICT_LEVELS.index(evidence.verdict.level) < states.VERDICT_LEVELS.index(shown.level):
                shown.level, shown.text = evidence.verdict.level, evidence.verdict.text
            if output == step.outputs[0]:
                sketch = states.sketch_of(evidence)
        shown.warnings += [one["code"] for one in answer["warnings"]]
        found = states.metrics_of(answer["result"], step.metrics)
        if len(step.argv) > 1:
            found = {f"{Path(output).stem}: {name}": one for name, one in found.items()}
        shown.metrics |= found
    return shown, sketch, 0, {}


def _command(argv: list[str]) -> tuple[int, dict[str, Any]]:
    """Run a command of swimid in this process. Return its exit status and its ``--json`` output."""
    from swimid.cli.main import main

    print("$", "swimid", *argv, file=sys.stderr, flush=True)
    sys.argv = ["swimid", *argv]
    out, code = io.StringIO(), 0
    try:
        with redirect_stdout(out):
            main(args=[*argv, "--json", "--no-progress", "--debug"], prog_name="swimid")
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    with suppress(ValueError):
        return code, json.loads(out.getvalue())
    message = "the command printed no result: read log.txt in the folder of the item"
    return code or 1, {"error": {"type": "UsageError", "message": message}}


def _end_with_parent() -> None:
    """End this process when the pipe on its standard input closes."""
    while os.read(0, 1):
        pass
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    sys.exit(_main(*sys.argv[1:]))
