"""Executors: a pool of threads on this machine, or the workers of a cluster of dask.distributed.

An executor is one of :mod:`concurrent.futures`. What it calls must be sent to the worker. A model cannot be
sent, because it holds compiled code. A :class:`Rebuilt` object is built by each worker instead.
"""

from __future__ import annotations

import functools
import importlib
import os
import pickle
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, chdir, contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any

from swimid.errors import InputError, extra_needed, first_line

#: Number of times that a cluster repeats a call whose worker was lost.
CLUSTER_RETRIES = 2
#: Time in which a cluster must answer, s.
CLUSTER_TIMEOUT_S = 30
#: Number of calls that wait for a cluster at a time.
WAITING = 64


@contextmanager
def open_executor(jobs: int, cluster: str | None = None) -> Iterator[Executor]:
    """Open an executor.

    Parameters
    ----------
    jobs : int
        Number of threads on this machine.
    cluster : str, optional
        Address (``tcp://host:8786``) or scheduler file of a cluster. Its workers do the calls.

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
            client = stack.enter_context(Client(**given, timeout=CLUSTER_TIMEOUT_S, set_as_default=False))
        except (OSError, ValueError) as error:
            raise InputError(f"the cluster {cluster} does not answer: {first_line(error)}") from error
        yield stack.enter_context(client.get_executor(retries=CLUSTER_RETRIES, pure=False))


class Rebuilt:
    """Object whose methods are called on the workers of an executor. Each worker builds it once.

    Parameters
    ----------
    pool : Executor
    build : str
        Function that returns the object, as ``module:function``.
    *arguments
        Arguments of the function. They are sent, and paths in them are relative to the working folder.
    """

    def __init__(self, pool: Executor, build: str, *arguments: Any) -> None:
        self._pool = pool
        self._recipe = build, pickle.dumps(arguments), os.getcwd()

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the object on a worker, and return its result."""
        return self._pool.submit(_call, self._recipe, method, arguments).result()


@contextmanager
def on_cluster(cluster: str | None, build: str, *arguments: Any) -> Iterator[Rebuilt | None]:
    """Yield an object that the workers of a cluster build (:class:`Rebuilt`); None without a cluster."""
    if cluster is None:
        yield None
        return
    with open_executor(1, cluster) as pool:
        yield Rebuilt(pool, build, *arguments)


def _call(recipe: tuple[str, bytes, str], method: str, arguments: tuple[Any, ...]) -> Any:
    return getattr(_build(*recipe), method)(*arguments)


@functools.lru_cache(maxsize=2)
def _build(build: str, arguments: bytes, folder: str) -> Any:
    module, _, name = build.partition(":")
    with chdir(folder):
        return attrgetter(name)(importlib.import_module(module))(*pickle.loads(arguments))
