"""Work shared among processes: much of a simulation is Python, which threads do not run side by side."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any, TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")

#: What the processes of a pool compute: they inherit it, nothing of it is sent.
_work: tuple[Callable[[Any], Any], list[Any]] | None = None


def mapped(function: Callable[[Item], Made], items: Iterable[Item], jobs: int) -> Iterator[Made]:
    """Results of a function in the order of its items, each as soon as it and those before are there.

    On Linux the items are shared among forked processes, which begin with all that is in memory here; only
    results are sent, and what else the function changes is lost. Elsewhere, where forking is not safe, they
    are shared among threads.
    """
    global _work
    items = list(items)
    if jobs <= 1 or len(items) <= 1 or _work is not None:
        yield from map(function, items)
        return
    if sys.platform != "linux":
        with ThreadPoolExecutor(jobs) as threads:
            yield from threads.map(function, items)
        return
    _work = function, items
    try:
        context = multiprocessing.get_context("fork")
        with ProcessPoolExecutor(min(jobs, len(items)), mp_context=context) as pool:
            yield from pool.map(_one, range(len(items)))
    finally:
        _work = None


def _one(index: int) -> Any:
    assert _work is not None
    function, items = _work
    return function(items[index])
