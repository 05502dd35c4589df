"""Evaluation of a function for many items in parallel threads or processes."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")

#: Function and items of the running process pool. Forked processes inherit them.
_work: tuple[Callable[[Any], Any], list[Any]] | None = None


def map_in_processes(function: Callable[[Item], Made], items: Iterable[Item], jobs: int) -> Iterator[Made]:
    """Yield the results of a function in the order of the items, each as soon as it is available.

    On Linux the items are divided among forked processes. Threads would not help, because most of a
    simulation is Python code, which threads do not run simultaneously. A forked process starts with
    everything in memory. Only results are sent back; other changes that the function makes are lost. On other
    systems forking is not safe, and threads are used.
    """
    global _work
    items = list(items)
    if jobs <= 1 or len(items) <= 1 or _work is not None:
        yield from map(function, items)
        return
    if sys.platform != "linux":
        with map_in_threads(function, items, jobs) as results:
            yield from results
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


@contextmanager
def map_in_threads(
    work: Callable[[Item], Made], items: Iterable[Item], jobs: int
) -> Iterator[Iterator[Made]]:
    """Evaluate a function for many items in threads.

    Parameters
    ----------
    work : callable
        Function that is called with one item, in any thread. After the first exception or interrupt it is not
        called again.
    items : iterable
    jobs : int
        Number of threads, at least one.

    Yields
    ------
    iterator
        Results in the order of the items. The iterator waits for each result. When the ``with`` block ends,
        items that have not started are cancelled.
    """
    failures: list[BaseException] = []

    def one(item: Item) -> Made:
        # the caller may notice an exception late, and the threads would process further items until then
        if failures:
            raise failures[0]
        try:
            return work(item)
        except BaseException as failure:
            failures.append(failure)
            raise

    pool = ThreadPoolExecutor(max(jobs, 1))
    try:
        waiting = [pool.submit(one, item) for item in items]
        yield (future.result() for future in waiting)
    finally:
        pool.shutdown(cancel_futures=True)
