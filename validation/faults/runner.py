"""Runs attacks in child processes with a time limit for each input, and counts how the inputs end."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import Result

from swimid.errors import SwimidError

#: Number of inputs that one child process tries.
CHUNK = 250


class Finding(BaseException):
    """Behaviour of swimid that an attack does not allow."""


@dataclass(frozen=True)
class Attack:
    """One kind of attack.

    Attributes
    ----------
    name : str
        Name in the table.
    attempt : callable
        Function ``attempt(rng, folder)`` that makes an input in an empty folder and gives it to swimid. It
        returns whether swimid accepts the input. A :class:`SwimidError` is a refusal, and any other exception
        is a finding.
    count : int
        Number of inputs. None takes the number that the command states.
    time_s : float
        Maximum time for one input, s.
    """

    name: str
    attempt: Callable[[np.random.Generator, Path], Any]
    count: int | None = None
    time_s: float = 20.0


@dataclass
class Counts:
    """Number of inputs of an attack by outcome, and the findings."""

    attack: Attack
    outcomes: Counter[str] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)

    def row(self) -> str:
        """Return the row of the table."""
        counts = [self.outcomes.total(), self.outcomes["refused"], self.outcomes["accepted"]]
        return f"| {self.attack.name} | {' | '.join(map(str, counts))} | {len(self.findings)} |"


def _overdue(*_: Any) -> None:
    raise Finding("takes too long")


def _attempt(attack: Attack, number: int, seed: int, folder: Path) -> tuple[str, str]:
    """Try one input; return its outcome, and the text of a finding."""
    rng = np.random.default_rng([seed, number, *attack.name.encode()])
    signal.signal(signal.SIGALRM, _overdue)
    signal.setitimer(signal.ITIMER_REAL, attack.time_s)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ("accepted" if attack.attempt(rng, folder) else "refused"), ""
    except SwimidError as error:
        if error.exit_status == 1 or not error.message:
            return "finding", repr(error)
        return "refused", ""
    except Finding as error:
        return "finding", str(error)
    except BaseException:  # any other exception is a bug of swimid
        return "finding", "".join(traceback.format_exc().splitlines(keepends=True)[-6:])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _work(attack: Attack, numbers: range, seed: int, answer: Connection) -> None:
    """Try inputs in this process, and report each before and after it is tried."""
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    os.dup2(sink, 2)
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        os.chdir(folder)
        for number in numbers:
            answer.send((number, "begun", ""))
            answer.send((number, *_attempt(attack, number, seed, Path(folder))))
        os.chdir("/")


def _chunk(attack: Attack, numbers: range, seed: int) -> Iterator[tuple[int, str, str]]:
    """Yield number, outcome and finding of inputs; the crash of a child process is a finding."""
    while numbers:
        reading, writing = multiprocessing.Pipe(duplex=False)
        child = multiprocessing.get_context("fork").Process(
            target=_work, args=(attack, numbers, seed, writing)
        )
        child.start()
        writing.close()
        last, done = numbers.start, True
        try:
            while True:
                if not reading.poll(attack.time_s + 60.0):
                    child.kill()
                    break
                number, outcome, text = reading.recv()
                last, done = number, outcome != "begun"
                if done:
                    yield number, outcome, text
        except EOFError:
            pass
        child.join()
        if done and last == numbers[-1]:
            return
        yield last, "finding", f"the process ends with {child.exitcode}"
        numbers = range(last + 1, numbers.stop)


def run(attacks: list[Attack], inputs: int, seed: int, jobs: int) -> list[Counts]:
    """Run attacks in parallel, and return their counts in the same order."""
    found = [Counts(attack) for attack in attacks]
    pieces = []
    for counts in found:
        total = counts.attack.count or inputs
        pieces += [(counts, range(k, min(k + CHUNK, total))) for k in range(0, total, CHUNK)]

    def one(piece: tuple[Counts, range]) -> None:
        counts, numbers = piece
        began = time.monotonic()
        for number, outcome, text in _chunk(counts.attack, numbers, seed):
            counts.outcomes[outcome] += 1
            if outcome == "finding":
                counts.findings.append(f"{counts.attack.name}, input {number}: {text}")
                print(counts.findings[-1], file=sys.stderr, flush=True)
        print(f"{counts.attack.name} {numbers} {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(one, pieces))
    return found


# ---------------------------------------------------------------- help for attacks


def mutated(data: bytes, rng: np.random.Generator, pieces: list[str]) -> bytes:
    """Return a file with one to four places changed, removed, inserted, repeated, replaced or cut off."""
    content = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(0, len(content) + 1))
        end = min(len(content), at + int(rng.integers(1, 40)))
        kind = rng.integers(0, 7)
        if kind == 0 and at < len(content):
            content[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            del content[at:end]
        elif kind == 2:
            content[at:at] = rng.bytes(int(rng.integers(1, 9)))
        elif kind == 3:
            content[at:at] = str(rng.choice(pieces)).encode("utf-8", "surrogatepass")
        elif kind == 4:
            content[at:at] = content[at:end]
        elif kind == 5:
            content[at:end] = b"\xff" * (end - at)
        else:
            del content[at:]
    return bytes(content)


def invoked(*words: str | Path) -> Result:
    """Run a command of swimid in this process.

    Raises
    ------
    Finding
        The command ends with another status than 0, 2, 3, 4 or 130, or shows a traceback.
    """
    from click.testing import CliRunner

    from swimid.cli.main import main

    ran = CliRunner().invoke(main, [str(word) for word in words], prog_name="swimid")
    if ran.exception is not None and not isinstance(ran.exception, SystemExit):
        raise ran.exception
    check_ending(ran.exit_code, ran.stderr)
    return ran


def command(*words: str | Path) -> tuple[int, str]:
    """Run a command of swimid in this process, and return its exit status and its messages."""
    ran = invoked(*words)
    return ran.exit_code, ran.stderr


def check_ending(status: int, messages: str) -> None:
    """Raise a finding if a command did not end in order."""
    if status not in (0, 2, 3, 4, 130) or "Traceback" in messages or "bug in swimid" in messages:
        raise Finding(f"status {status}: {messages[-800:]}")
