"""swimid: system identification for swimming robots, from logs to published parameters.

Conventions of the whole package
--------------------------------
Units
    SI units and radians, in memory and in every file. The name of a column or key ends in its unit (``x_m``,
    ``yaw_rad``, ``u_m_s``). Degrees and grams appear only where they are customary, and the name then says so
    (``amplitude_deg``).
Frames
    World frame: x, y in the plane of motion, z up; yaw about z, counter-clockwise. Body frame: x forward
    (nose), y to port, z up. Surge ``u``, sway ``v`` and yaw rate ``r`` are components in the body frame. For
    motion in the vertical plane, z replaces y and pitch replaces yaw.
Time
    The column ``t_s`` has the time stamps of the recording in s. They increase strictly.
Missing data
    A missing value is NaN in an array and an empty cell in a file. Gaps are never filled without notice.
Packages
    Each package is named after its subject. ``logs``, ``tracking`` and ``inertial`` read and create logs.
    ``rig``, ``propulsion``, ``swimmer`` and ``blackbox`` each identify one family of experiments and share
    ``fitting``. ``simulation``, ``effects``, ``diagnosis``, ``sensitivity_analysis``, ``optimisation`` and
    ``exporters`` use the identified models. All packages use ``results``, ``robots`` and ``files``. ``cli``
    is the command line. Packages import each other in one direction only (``docs/architecture.md``).
"""

from typing import Any

__version__ = "0.2.0"


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    from importlib import import_module

    from swimid.api import NAMES
    from swimid.errors import suggestion

    if name not in NAMES:
        raise AttributeError(f"swimid has no '{name}'; {suggestion(name, sorted(NAMES), 'it has')}")
    return getattr(import_module(NAMES[name]), name)


def __dir__() -> list[str]:
    from swimid.api import NAMES

    return sorted([*NAMES, "__version__"])
