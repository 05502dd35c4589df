"""Work on many items shared among threads or processes."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")

#: What the processes of a pool compute: they inherit it, nothing of it is sent.
_work: tuple[Callable[[Any], Any], list[Any]] | None = None


def mapped(function: Callable[[Item], Made], items: Iterable[Item], jobs: int) -> Iterator[Made]:
    """Yield the results of a function in the order of its items, each as soon as it is there.

    Much of a simulation is Python, which threads do not run side by side.

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


@contextmanager
def in_threads(work: Callable[[Item], Made], items: Iterable[Item], jobs: int) -> Iterator[Iterator[Made]]:
    """Results of work on items, in the items' order.

    Parameters
    ----------
    work : callable
        Called with one item, in any thread. The first failure, an interrupt too, is that of every item
        which has not begun by then.
    items : iterable
        What to work on.
    jobs : int
        Threads; at least one.

    Yields
    ------
    iterator
        Waits for each result. What has not begun when the block is left is cancelled.
    """
    failures: list[BaseException] = []

    def one(item: Item) -> Made:
        # Whoever waits for the results may hear of a failure late, and the queue would go on till then.
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
