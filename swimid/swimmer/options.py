"""The options of ``fit-graybox``, and those of every verb on robots with links."""

from __future__ import annotations

from typing import Any

from swimid.options import option

#: Integration step of a robot with links, at most, s.
STEP_S = 0.005


def readings() -> Any:
    """A mapping of ambiguities of the robot's source to the reading that is taken."""
    return option(
        {},
        flag="--reading",
        metavar="NAME=OPTION",
        help="Read an ambiguity of the robot's source otherwise. Repeatable.",
    )


def step(recorded: str = "dt") -> Any:
    """The longest integration step, s."""
    return option(STEP_S, gt=0, help="Integration step, s.", recorded=recorded)
