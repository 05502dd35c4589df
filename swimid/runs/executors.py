"""Executor of a run: a pool of workers on this machine, or the workers of a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

from swimid.errors import InputError, extra_needed, first_line

#: Number of times that a cluster does an item again whose worker was lost.
RETRIES = 2
#: Time in which a cluster must answer, s.
TIMEOUT_S = 30


@contextmanager
def opened(jobs: int, cluster: str | None = None) -> Iterator[Executor]:
    """Open an executor of :mod:`concurrent.futures`.

    On this machine it has ``jobs`` threads, each of which waits for the process of an item. On a cluster its
    calls run on the workers of dask.distributed.

    Parameters
    ----------
    jobs : int
        Number of items at a time on this machine.
    cluster : str, optional
        Address (``tcp://host:8786``) or scheduler file of a cluster.

    Raises
    ------
    UsageError
        If ``distributed`` is not installed.
    InputError
        If the cluster does not answer.
    """
    with ExitStack() as stack:
        if cluster is None:
            pool = stack.enter_context(ThreadPoolExecutor(jobs))
            stack.callback(pool.shutdown, wait=False, cancel_futures=True)
            yield pool
            return
        with extra_needed("a cluster", "cluster"):
            from distributed import Client
        given = {"address": cluster}
        if Path(cluster).is_file():
            given = {"scheduler_file": cluster}
        try:
            client = stack.enter_context(Client(**given, timeout=TIMEOUT_S, set_as_default=False))
        except (OSError, ValueError) as error:
            raise InputError(f"the cluster {cluster} does not answer: {first_line(error)}") from error
        yield stack.enter_context(client.get_executor(retries=RETRIES, pure=False))
