"""The commands: what each is called, what it says, and which function does it."""

from __future__ import annotations

from swimid.cli.builder import Verb

#: Commands by purpose, in the order one uses them.
SECTIONS: list[tuple[str, list[str]]] = [
    ("Make logs", ["track", "import"]),
    ("Identify", ["fit-drag", "fit-propulsion", "rwls", "fit-graybox"]),
    ("Simulate and compare", ["simulate", "compare"]),
    ("Diagnose", ["diagnose", "sensitivity"]),
    ("Publish", ["plot", "report", "export"]),
    ("Help yourself", ["schema", "doctor"]),
]

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
    Verb(
        "fit-propulsion",
        function="swimid.propulsion.fit_propulsion:fit_propulsion",
        options="swimid.propulsion.options:FitPropulsionOptions",
        output="Parameter file to write (YAML).",
        help="""Identify the propulsion of a caudal fin.

        TRIALS is a trials file of a cruise experiment (energy recoil law: efficiency and amplitude
        offset), or of straight free-swim trials (beat-averaged thrust and surge drag).

        \b
        Examples:
          swimid fit-propulsion cruise.yaml --drag drag.yaml -o propulsion.yaml
          swimid fit-propulsion straight_runs.yaml -o surge.yaml
        """,
    ),
    Verb(
        "rwls",
        function="swimid.blackbox.rwls:rwls",
        options="swimid.blackbox.options:RwlsOptions",
        output="Parameter file to write.",
        output_flags=("-o", "--result"),
        argument="LOG...",
        short="ARX/ARMAX model by recursive weighted least squares.",
        help="""Identify a discrete-time model from input and output columns.

        A(z^-1) y = B(z^-1) u + C(z^-1) e with A = 1 + a1 z^-1 + ..., B = b1 z^-nk + ..., by recursive
        weighted least squares, with one-step, k-step and free-run errors on fitted and held-out data,
        residual tests, poles and stability. LOG may also be a trials file of the experiment arma.

        \b
        Example:
          swimid rwls run.csv --input cmd1_rad --output u_m_s --na 4 --nb 3 --weight 0.95 \\
              --validate 0.25 -o arma.yaml
        """,
    ),
    Verb(
        "compare",
        function="swimid.simulation.compare:compare",
        options="swimid.simulation.options:CompareOptions",
        output="Comparison file to write (YAML).",
        short="Measured trials against their simulation.",
        help="""Compare recorded trials with their simulation.

        TRIALS is a trials file of any experiment; the parameter file says which model is to describe it.
        Errors by channel and trial, stroke by stroke and over the stroke's phase; the report draws them. Of a
        robot in space, trials that repeat a motion are averaged and shown beside the paper's tables.

        \b
        Examples:
          swimid compare trials.yaml --params tfish.yaml -o comparison.yaml
          swimid compare trials.yaml --params drag.yaml
          swimid report comparison.yaml -o comparison.html
        """,
    ),
)
