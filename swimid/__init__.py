"""swimid: system identification for swimming robots, from logs to published parameters.

Conventions, stated once for the whole package
----------------------------------------------
Units
    SI and radians everywhere inside and in every file. A column or key carries its unit
    as a suffix (``x_m``, ``yaw_rad``, ``u_m_s``). Degrees and grams appear only where the
    field writes them and the name then says so (``amplitude_deg``).
Frames
    World frame: x, y in the plane of motion, z up; yaw about z, counter-clockwise.
    Body frame: x forward (nose), y to port, z up. Surge ``u``, sway ``v`` and yaw rate
    ``r`` are components in the body frame. In the vertical plane z takes the place of y
    and pitch that of yaw.
Time
    ``t_s``, seconds, strictly increasing, from the recording's own stamps.
Missing data
    NaN in arrays, an empty cell in files. Nothing is filled silently.
Packages
    Each is named after its subject: ``logs``, ``tracking``, ``inertial``; one for each family of experiment:
    ``rig``, ``propulsion``, ``swimmer``, ``blackbox``; ``fitting``, which these share; ``simulation``,
    ``effects``, ``diagnosis``, ``sensitivity_analysis``, ``exporters``; ``results``, ``robots``, ``files``,
    which all use; ``cli``. Imports run one way (``docs/architecture.md``).
"""

from typing import Any

__version__ = "0.2.0"


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    from importlib import import_module

    from swimid.api import NAMES

    if name not in NAMES:
        raise AttributeError(f"swimid has no '{name}'; it has: {', '.join(sorted(NAMES))}")
    return getattr(import_module(NAMES[name]), name)


def __dir__() -> list[str]:
    from swimid.api import NAMES

    return sorted([*NAMES, "__version__"])
