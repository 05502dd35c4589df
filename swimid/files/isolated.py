"""Reading of files of other programs in a child process, and limits on the memory that the files may take.

A library that is written in C may crash on a damaged file. A small file may expand to many gigabytes. In a
child process with limits, both cases end in an :class:`InputError` for the file.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import pickle
import signal
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from swimid import reading
from swimid.errors import InputError, SwimidError, first_line
from swimid.files.memory import physical_bytes

Made = TypeVar("Made")

#: Size of the samples of a file in memory that is always allowed, bytes.
ALWAYS_BYTES = 256 << 20
#: Maximum ratio of the size of the samples in memory to the size of the file. Measured samples are noisy, so
#: that their compression ratio is lower.
MAX_EXPANSION = 100
#: Maximum fraction of the physical memory for the samples of one file.
MEMORY_SHARE = 0.25
#: Number of copies of the samples that a reader may hold in memory at once.
N_READER_COPIES = 4
#: Maximum time for reading a file, s, and additional time for each byte of the file, s.
MAX_TIME_S, TIME_S_PER_BYTE = 60.0, 5e-6
#: Option of the Linux system call ``prctl`` that selects the signal at the end of the parent process.
PR_SET_PDEATHSIG = 1
#: Whether this process is a child process that reads a file.
_is_child = False


def max_bytes(path: Path) -> int:
    """Return the maximum size of the samples of a file in memory, bytes."""
    most = max(ALWAYS_BYTES, MAX_EXPANSION * path.stat().st_size)
    return int(min(most, MEMORY_SHARE * physical_bytes()))


def check_size(path: Path, size: int) -> None:
    """Raise an error if the samples of a file take more memory than is allowed.

    ``size`` is the size in bytes that the file states for its samples.

    Raises
    ------
    InputError
    """
    most = max_bytes(path)
    if size > most:
        text = f"the samples take {size / 1e6:.0f} MB of memory; at most {most / 1e6:.0f} MB are allowed"
        raise InputError(text, file=path, hint="divide the recording into several files")


def check_parquet(path: Path, file: Any) -> None:
    """Raise an error if a Parquet file, opened by pyarrow, takes more memory than is allowed."""
    about = file.metadata
    stored = sum(about.row_group(k).total_byte_size for k in range(about.num_row_groups))
    check_size(path, max(stored, 8 * about.num_rows * about.num_columns))


def check_zip(path: Path) -> None:
    """Raise an error if the members of a ZIP file take more memory than is allowed."""
    with zipfile.ZipFile(path) as archive:
        check_size(path, sum(member.file_size for member in archive.infolist()))


def run_isolated(
    function: Callable[..., Made], *args: Any, file: Path, fork: bool = sys.platform == "linux"
) -> Made:
    """Call a function that reads a file in a child process, and return its result.

    On Linux the child process is a fork, which starts within milliseconds, and its memory is limited. On
    other systems it is a new Python process, and only its time is limited. If this process is already such a
    child process, the function is called directly.

    Parameters
    ----------
    function : callable
        Function of a module. Its arguments and its result can be pickled.
    *args
        Arguments of the function.
    file : Path
        File that the function reads, for messages and limits.
    fork : bool
        Whether the child process is a fork.

    Raises
    ------
    InputError
        The child process crashed, or needed too much time or memory.
    SwimidError
        Error that the function raised.
    """
    if _is_child:
        return function(*args)
    size = file.stat().st_size
    time_s, memory = MAX_TIME_S + TIME_S_PER_BYTE * size, N_READER_COPIES * max_bytes(file)
    if fork:
        answer, status = _in_fork(function, args, time_s, memory)
    else:
        answer, status = _in_new_process(function, args, time_s)
    if not answer:
        text = "crashes its reader; the file is damaged"
        if status == -signal.SIGALRM:
            text = f"is not read within {time_s:.0f} s; the file is damaged, or expands too much"
        raise InputError(text, file=file, hint="export or copy the file again")
    try:
        result, error, opened = pickle.loads(answer)
    except (pickle.UnpicklingError, EOFError) as cut:
        raise InputError("crashes its reader; the file is damaged", file=file) from cut
    for path in opened:
        reading.note(path)
    if isinstance(error, MemoryError):
        text = f"needs more than {memory / 1e6:.0f} MB of memory, the maximum for a file of {size} bytes"
        raise InputError(text, file=file, hint="divide the recording, or export it again")
    if error is not None:
        raise error
    made: Made = result
    return made


def end_with(parent: int) -> None:
    """Tell Linux to kill this process when the parent process ends (``man prctl``). Linux only."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _in_fork(
    function: Callable[..., Any], args: tuple[Any, ...], time_s: float, memory: int
) -> tuple[bytes, int]:
    """Call a function in a forked process; return its pickled result, and the exit status of the process."""
    reading, writing = os.pipe()
    parent = os.getpid()
    with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # about forking with threads
        child = os.fork()
    if child == 0:
        try:
            end_with(parent)
            _limit(time_s, memory)
            with open(writing, "wb") as stream:
                stream.write(_answer(function, args))
        finally:
            os._exit(0)
    os.close(writing)
    try:
        with open(reading, "rb") as stream:
            answer = stream.read()
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return answer, status


def _limit(time_s: float, memory: int) -> None:
    """Limit the run time of this process, s, and the additional memory that it may allocate, bytes."""
    import resource

    # Avoid the default allocator of pyarrow, which pandas uses for text. It reserves 1 GiB at once.
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"
    if pyarrow := sys.modules.get("pyarrow"):
        pyarrow.set_memory_pool(pyarrow.system_memory_pool())
    faulthandler.disable()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles Ctrl-C
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, time_s)
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    present = 1024 * int(fields["VmData"].split()[0])
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = present + memory
    if most != resource.RLIM_INFINITY:
        limit = min(limit, most)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def _answer(function: Callable[..., Any], args: tuple[Any, ...]) -> bytes:
    """Call a function, and return, pickled, its result or its error and the paths of the files it read."""
    global _is_child
    _is_child = True
    try:
        with reading.record() as record:
            made = function(*args)
        return pickle.dumps((made, None, [*record.paths]), pickle.HIGHEST_PROTOCOL)
    except (SwimidError, MemoryError, ImportError) as error:
        return pickle.dumps((None, error, []))
    except Exception as error:  # noqa: BLE001 - its class may be unknown to the parent process
        return pickle.dumps((None, RuntimeError(first_line(error)), []))


def _in_new_process(function: Callable[..., Any], args: tuple[Any, ...], time_s: float) -> tuple[bytes, int]:
    """Call a function in a new Python process; return its pickled result, and the exit status."""
    program = "from swimid.files import isolated; isolated.serve()"
    call = pickle.dumps((function, args))
    try:
        done = subprocess.run(
            [sys.executable, "-c", program], input=call, stdout=subprocess.PIPE, timeout=time_s, check=False
        )
    except subprocess.TimeoutExpired:
        return b"", -signal.SIGALRM if hasattr(signal, "SIGALRM") else 1
    return done.stdout, done.returncode


def serve() -> None:
    """Call the pickled function on the standard input, and write its pickled result to standard output."""
    function, args = pickle.load(sys.stdin.buffer)
    sys.stdout.buffer.write(_answer(function, args))
