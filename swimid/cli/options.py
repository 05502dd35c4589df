"""The options of ``doctor``; ``schema`` has none."""

from __future__ import annotations

from swimid.options import Options, option


class DoctorOptions(Options):
    """What ``doctor`` can be told."""

    warm_up: bool = option(False, help="Compile the numerical kernels now, so that no later run waits.")
