"""Work on many items in threads, stopped at the first failure or interrupt."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def in_threads(
    work: Callable[[Item], Result], items: Iterable[Item], jobs: int
) -> Iterator[Iterator[Result]]:
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

    def one(item: Item) -> Result:
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
