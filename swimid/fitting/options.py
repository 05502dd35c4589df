"""Options that several fits share."""

from __future__ import annotations

from typing import Any, Literal

from swimid.options import option

StartState = Literal["auto", "rest", "estimate"]


def fixed() -> Any:
    """Return the option for parameters that are held at a value."""
    return option({}, flag="--fix", metavar="NAME=VALUE", help="Hold a parameter at a value.")


def freed() -> Any:
    """Return the option for parameters that are estimated although they are fixed by default."""
    return option((), flag="--free", metavar="NAME", help="Estimate a parameter that is fixed by default.")


def bounds() -> Any:
    """Return the option for bounds that replace those of a parameter."""
    return option({}, metavar="NAME=LOW,HIGH", help="Change a parameter's bounds.")


def jobs(help: str = "Threads; default one per processor.") -> Any:
    """Return the option for the number of threads, which changes no result and is not recorded."""
    return option(None, ge=1, help=help, recorded=False)
