"""Options that several fits have."""

from __future__ import annotations

from typing import Any, Literal

from swimid.options import option

StartState = Literal["auto", "rest", "estimate"]


def fixed() -> Any:
    """A mapping of parameters to values they are held at."""
    return option({}, flag="--fix", metavar="NAME=VALUE", help="Hold a parameter at a value.")


def freed() -> Any:
    """Names of parameters to estimate that are fixed by default."""
    return option((), flag="--free", metavar="NAME", help="Estimate a parameter that is fixed by default.")


def bounds() -> Any:
    """A mapping of parameters to bounds other than their own."""
    return option({}, metavar="NAME=LOW,HIGH", help="Change a parameter's bounds.")


def jobs(help: str = "Threads; default one per processor.") -> Any:
    """How many threads; no result depends on it, and none records it."""
    return option(None, ge=1, help=help, recorded=False)
