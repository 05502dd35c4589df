"""The commands: what each is called, what it says, and which function does it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from swimid.cli.builder import EVIDENCE, Verb
from swimid.cli.common import Shared
from swimid.errors import UsageError


def _a_page_needs_a_file(output: Path | None, options: dict[str, Any], shared: Shared) -> None:
    """Refuse to print HTML by default; under ``--json`` the document is JSON."""
    if output is not None:
        return
    if shared.as_json:
        options["format"] = "json"
    elif shared.output is None and options["format"] in (None, "html"):
        raise UsageError("an HTML page needs a file", hint="add -o report.html")


def _verb(room: str, name: str, **more: Any) -> Verb:
    """A command whose function and options are called as it is, and lie in this room."""
    words = name.replace(" ", "-").split("-")
    function = f"swimid.{room}.{'_'.join(words)}:{'_'.join(words)}"
    options = f"swimid.{room}.options:{''.join(word.capitalize() for word in words)}Options"
    return Verb(name, function=function, options=options, **more)


#: Commands by purpose, in the order one uses them.
SECTIONS: list[tuple[str, list[str]]] = [
    ("Make logs", ["track", "import"]),
    ("Identify", ["fit-drag", "fit-propulsion", "rwls", "fit-graybox"]),
    ("Simulate and compare", ["simulate", "compare"]),
    ("Diagnose", ["diagnose", "sensitivity"]),
    ("Put to work", ["map", "optimise"]),
    ("Publish", ["plot", "report", "export"]),
    ("Help yourself", ["schema", "doctor"]),
]

VERBS = (
    _verb(
        "rig",
        "fit-drag",
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
    _verb(
        "propulsion",
        "fit-propulsion",
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
    _verb(
        "blackbox",
        "rwls",
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
    _verb(
        "simulation",
        "compare",
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
    _verb(
        "swimmer",
        "fit-graybox",
        beside=(EVIDENCE, ".front.csv"),
        output="Parameter file to write (YAML).",
        help="""Identify the coefficients of a multi-link swimmer.

        TRIALS is a trials file of a free-swim or multibody experiment, with a robot that has links: tfish,
        dolphin, sealion, or a robot file of your own. Ctrl-C keeps the best point so far, and the generations
        of a front.

        \b
        Examples:
          swimid fit-graybox trials.yaml -o tfish.yaml
          swimid fit-graybox trials.yaml --share c_f --starts 8 -o tfish.yaml
          swimid fit-graybox trials.yaml --channels u_m_s,yaw_rate_rad_s --free d_p -o tfish.yaml
          swimid fit-graybox strokes.yaml --method hybrid -o sealion.yaml
          swimid fit-graybox strokes.yaml --method nsga2 --front sealion.front.csv --pick 17 -o mine.yaml
        """,
    ),
    _verb(
        "simulation",
        "simulate",
        beside=(),
        output="Log to write (.csv or .parquet).",
        argument="",
        help="""Simulate any robot from any parameter file.

        A robot with links swims as its beat says; a falling weight, a cruise and a discrete-time model
        have options of their own. Printed with the uncertainty the parameter file gives.

        \b
        Examples:
          swimid simulate --params tfish.yaml --frequency-hz 1 --amplitude-deg 20 --duration-s 15 -o sim.csv
          swimid simulate --robot dolphin --frequency-hz 2.5 --amplitude-deg 27 --animate swim.mp4
          swimid simulate --robot sealion --stroke characteristic --cycles 3 -o stroke.csv
          swimid simulate --params tfish.yaml --trials trials.yaml -o simulated
          swimid simulate --params drag.yaml --pulling-mass-kg 0.02 --duration-s 8 -o drop.csv
          swimid simulate --params arma.yaml --input run.csv -o free_run.csv
        """,
    ),
    _verb(
        "sensitivity_analysis",
        "sensitivity",
        output="Sensitivity file to write (YAML).",
        short="Which coefficient each output is most sensitive to.",
        help="""Vary the coefficients of a robot with links.

        TRIALS is a trials file of a free-swim or multibody experiment. Each output (speeds, rates, the misfit
        of each measured channel) is told which coefficients it is sensitive to, over ranges of all at once.
        A run that was stopped goes on where it was when it is started again.

        \b
        Examples:
          swimid sensitivity trials.yaml -o sens.yaml
          swimid sensitivity trials.yaml --params tfish.yaml --range stderr -o sens.yaml
          swimid sensitivity trials.yaml --range 20% --range c_d4=2,6 --samples 512 -o sens.yaml
        """,
    ),
    _verb(
        "diagnosis",
        "diagnose",
        output="Gap file to write (YAML).",
        short="The unmodelled effect behind a gap between trials and simulation.",
        help="""Name the effect that a model lacks.

        TRIALS is a trials file of any experiment; the parameter file says which model is to describe it, and
        without one the robot file does. The model is refitted alone and with every effect that applies to it;
        what each leaves beyond the noise says how likely it is, that there is no gap, and that the cause is
        none of these. The answer is one effect, a combination, several that the trials cannot tell apart, or
        none. Every answer is a result: exit status 0.

        \b
        Examples:
          swimid diagnose trials.yaml -o gap.yaml
          swimid diagnose trials.yaml --params tfish.yaml -o gap.yaml
          swimid diagnose trials.yaml --params tfish.yaml --effects servo-lag,servo-delay,time-offset
          swimid diagnose trials.yaml --params drag.yaml --effect my_effect.py -o gap.yaml
          swimid diagnose trials.yaml --params tfish.yaml --power
          swimid report gap.yaml -o gap.html
        """,
    ),
    Verb(
        "map",
        function="swimid.optimisation.performance_map:performance_map",
        options="swimid.optimisation.options:MapOptions",
        output="Map file to write (YAML).",
        argument="",
        short="Speed, cost of transport and turning over a grid of gaits.",
        help="""Map what a robot comes to over a grid of gaits.

        Speed, cost of transport, Strouhal number, turning, power and torque over one or two of frequency,
        amplitude, bias, asymmetry and any coefficient. Recorded trials are set beside it, and the range they
        cover is marked. A run that was stopped goes on where it was when it is started again.

        \b
        Examples:
          swimid map --robot dolphin --amplitude-deg 27 \\
              --over frequency_hz=1:5:9 --over K_s=0.2:3.0:15 -o map.yaml
          swimid map --params tfish.yaml --trials trials.yaml --over frequency_hz=0.6:2:8 \\
              --over amplitude_deg=15:35:5 -o map.yaml
          swimid map --robot tfish --waveform a-cpg --frequency-hz 1 --amplitude-deg 35 \\
              --over bias_deg=25:35:3 --over asymmetry=0:0.4:2 --duration-s 20 -o steering.yaml
        """,
    ),
    _verb(
        "optimisation",
        "optimise stiffness",
        output="Rule file to write (YAML).",
        argument="",
        short="The stiffness of a passive joint as a rule over frequency and amplitude.",
        help="""Find the best stiffness of a passive joint over frequency and amplitude.

        At every point of the grid NSGA-II searches the stiffness; a quadratic function of the frequency for
        each amplitude is the rule, which a controller reads as YAML or as a C header. A run that was
        stopped goes on where it was when it is started again.

        \b
        Examples:
          swimid optimise stiffness --params tfish.yaml --over frequency_hz=0.6:2:8 \\
              --over amplitude_deg=15:35:5 -o rule.yaml --header rule.h
          swimid optimise stiffness --robot dolphin --amplitude-deg 27 --over frequency_hz=1:5:9 \\
              --between 0.1,3 --objective cost-of-transport -o rule.yaml
        """,
    ),
    _verb(
        "optimisation",
        "optimise gait",
        output="Gait file to write (YAML).",
        argument="",
        short="The best gait within limits, how sure it is, and a robust one.",
        help="""Find the best gait within limits.

        Any of frequency, amplitude, bias, asymmetry, phase lag and coefficients against speed, turning, cost
        of transport or power. With standard errors in the parameter file it says how sure the best gait is,
        and gives a robust one beside it.

        \b
        Examples:
          swimid optimise gait --params tfish.yaml --vary frequency_hz=0.6,2 --vary d_p=0,0.2 \\
              --amplitude-deg 30 --limit joint_rate_deg_s=120 -o gait.yaml
          swimid optimise gait --robot tfish --waveform a-cpg --goal radius --vary bias_deg=0,40 \\
              --vary asymmetry=0,0.6 --frequency-hz 1 --amplitude-deg 35 --limit tank_m=4 -o turn.yaml
          swimid optimise gait --robot dolphin --amplitude-deg 27 --goal speed --goal cost-of-transport \\
              --vary frequency_hz=1,5 --vary K_s=0.1,3 -o front.yaml
        """,
    ),
    _verb(
        "exporters",
        "export",
        beside=(),
        output="The file to write. Without it, or with -o -, it goes to stdout.",
        argument="PARAMS",
        prints=True,
        short="Identified coefficients for MuJoCo, Gazebo, or as JSON.",
        help="""Write identified coefficients as a simulator reads them.

        PARAMS is a parameter file of a multi-link robot, or of a falling weight or towed body (Gazebo
        and JSON). Each thing the simulator cannot carry is named in a warning.

        \b
        Examples:
          swimid export tfish.yaml --to mjcf --added-mass fold -o tfish.xml
          swimid export drag.yaml --to gazebo -o boxfish.sdf
          swimid export tfish.yaml --to json -o tfish.json
        """,
    ),
    _verb(
        "results",
        "report",
        beside=(),
        output="The report. Without it, or with -o -, md and json go to stdout.",
        argument="RESULT...",
        prints=True,
        check=_a_page_needs_a_file,
        short="One page from result files: figures, checks, methods, provenance.",
        help="""Make one self-contained page from any mixture of results.

        RESULT is a parameter file, a gap file or a log. The evidence that swimid wrote beside it
        (drag.yaml: drag.evidence.json) brings its figures, checks and methods. Nothing is
        computed again.

        \b
        Examples:
          swimid report drag.yaml propulsion.yaml -o report.html
          swimid report drag.yaml --format md
        """,
    ),
    _verb(
        "logs",
        "plot",
        beside=(),
        output="The picture: .html, .svg or .png.",
        argument="LOG...",
        required=True,
        short="Logs as figures: channels, track from above, spectra, two sensors over each other.",
        help="""Draw logs. Several are drawn over each other: one trial seen by two sensors.

        \b
        Examples:
          swimid plot run.csv -o run.png
          swimid plot imu.csv camera.csv -o both.html
        """,
    ),
    _verb(
        "tracking",
        "track video",
        beside=(EVIDENCE, ".png"),
        output="The log, CSV or Parquet by its ending.",
        argument="VIDEO",
        required=True,
        help="""Track coloured markers in a video: a log of pose and speeds.

        VIDEO is a film; or a folder of pictures, or a pattern of their names, both with --fps.
        Writes the log, its evidence (<stem>.evidence.json) and a plot (<stem>.png). Prints the path speed,
        the steady speed, the stroke's frequency and amplitudes and the accelerations, each with its 95 %
        interval.

        \b
        Example:
          swimid track video pool.mp4 --setup setup.yaml -o run.csv --overlay overlay.mp4
          swimid track video frames/%05d.png --fps 30 --setup setup.yaml -o run.csv
        """,
    ),
    _verb(
        "tracking",
        "track setup",
        beside=(".markers.png",),
        output="The setup file to write.",
        argument="VIDEO",
        required=True,
        help="""Draft a setup from a video: propose markers, draw them, write a YAML file to edit.

        Works unattended and without a display. The file can be used as it is.

        \b
        Example:
          swimid track setup pool.mp4 -o setup.yaml
          swimid track setup pool.mp4 --marker nose@412,230 --marker tail@371,236 -o setup.yaml
        """,
    ),
    _verb(
        "inertial",
        "track imu",
        output="The log, CSV or Parquet by its ending.",
        argument="IMU",
        required=True,
        help="""Make motion of an inertial recording: velocity, position and attitude with their bands.

        Faults of recording are found, named, and repaired or refused. Without --with the summary says after
        how many seconds the integrated path is not to be trusted. Writes the log and its evidence.

        \b
        Example:
          swimid track imu imu.csv -o run.csv
          swimid track imu imu.csv --with camera.csv -o run.csv
          swimid track imu imu.csv --method paper --motion-mode marching -o paper.csv
        """,
    ),
    Verb(
        "import",
        function="swimid.cli.import_log:import_files",
        options="swimid.logs.options:ImportCommandOptions",
        beside=(),
        output="The log, CSV or Parquet by its ending; a folder for several; with --guess the mapping.",
        argument="FILE...",
        short="Logs of other programs, through a mapping, to the log format.",
        help="""Import logs: delimited text, MATLAB, HDF5, Parquet, JSON lines, MCAP, ULog.

        A mapping says which source column becomes which column of the log, and in which unit it was
        written. Without one the columns must have the names of the log format already. Beside each log
        goes its evidence (<stem>.evidence.json).

        \b
        Examples:
          swimid import field.csv --guess -o map.yaml
          swimid import field.csv --map map.yaml -o run.csv
          swimid import run.csv --scale 0.0008 --along -y --start 1.2 --end 2.4 -o drop.csv
          swimid import STATES1.txt STATES2.txt --map docs/examples/msu-states.yaml -o logs/
        """,
    ),
)

#: Commands about the program itself; no page of the docs is about them.
HELPERS = (
    Verb(
        "schema",
        function="swimid.cli.schema:schema",
        options="swimid.options:Options",
        beside=(),
        output="Write the schema to this file instead of stdout.",
        argument="[NAME]",
        help="""Print the JSON Schema of a file format.

        Without NAME, list the formats.

        \b
        Example:
          swimid schema trials > trials.schema.json
        """,
    ),
    _verb(
        "cli",
        "doctor",
        beside=(),
        output="Write the findings as JSON to this file.",
        argument="",
        help="""Check the installation: versions, video codecs, compiled kernels.

        \b
        Example:
          swimid doctor --warm-up
        """,
    ),
)
