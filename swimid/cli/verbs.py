"""The commands: what each is called, what it says, and which function does it."""

from __future__ import annotations

from swimid.cli.builder import Verb

VERBS = (
    Verb(
        "fit-drag",
        function="swimid.rig.fit_drag:fit_drag",
        options="swimid.rig.options:FitDragOptions",
        output="Parameter file to write (YAML).",
        help="""Identify drag, added mass and friction from a rig.

        TRIALS is a trials file of a falling-weight, towed or free-decay experiment.

        \b
        Examples:
          swimid fit-drag trials.yaml -o drag.yaml
          swimid fit-drag trials.yaml --method two-point --points 0.293,0.584 -o drag.yaml
          swimid fit-drag towed.yaml --free linear_drag --free dry_friction -o rig.yaml
        """,
    ),
)
