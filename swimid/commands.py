"""Table of all commands, and the class that declares argument and output of a command.

The table has only the names of modules, so that commands can be listed without importing the packages.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swimid.options import Options

#: Suffix of the name of an evidence file, which a command writes next to its result.
EVIDENCE = ".evidence.json"
#: Kinds of files that commands make, besides the result formats (such as ``gap``); empty for no file.
KINDS = ("", "log", "parameters", "setup", "picture", "page")
#: Commands by the heading under which ``swimid --help`` lists them: name, function, class of options, and
#: first line of the help. Modules are those of the package ``swimid``. The class of options is in the module
#: ``options`` of the package of the function, unless its module is stated (``rig.fit_drag:FitDragOptions``).
TABLE: dict[str, list[tuple[str, str, str, str]]] = {
    "Start": [
        ("init", "projects.init:init", "InitOptions",
         "Look at a folder of films, logs and tables, and draft the files to work with them."),
        ("robot", "projects.robot:robot", "RobotOptions",
         "Draft a robot file from a file in MJCF or URDF."),
        ("sample", "projects.sample:sample", "SampleOptions",
         "Copy sample recordings of the installed version to a folder."),
    ],
    "Make logs": [
        ("import", "cli.commands:import_file", "ImportLogOptions",
         "Import a log of a tracker, of motion capture, of a robot or of a laboratory, or any table."),
        ("track camera", "tracking.track_camera:track_camera", "TrackCameraOptions",
         "Calibrate a camera and its lens from pictures of a checkerboard."),
        ("track imu", "inertial.track_imu:track_imu", "TrackImuOptions",
         "Compute velocity, position and attitude from an inertial recording, each with its uncertainty "
         "band."),
        ("track setup", "tracking.track_setup:track_setup", "TrackSetupOptions",
         "Draft a setup from a film: propose markers, draw them, and write a YAML file to edit."),
        ("track video", "tracking.track_video:track_video", "TrackVideoOptions",
         "Track coloured markers in a film, and write a log of pose and speeds."),
    ],
    "Identify": [
        ("fit", "fitting.fit:fit", "FitOptions",
         "Identify the model of an experiment that has no command of its own."),
        ("fit-drag", "rig.fit_drag:fit_drag", "FitDragOptions",
         "Identify drag, added mass and friction from a rig."),
        ("fit-graybox", "swimmer.fit_graybox:fit_graybox", "FitGrayboxOptions",
         "Identify the coefficients of a multi-link swimmer."),
        ("fit-propulsion", "propulsion.fit_propulsion:fit_propulsion", "FitPropulsionOptions",
         "Identify the propulsion of a caudal fin."),
        ("rwls", "blackbox.rwls:rwls", "RwlsOptions",
         "Identify an ARX or ARMAX model by recursive weighted least squares."),
    ],
    "Simulate and compare": [
        ("compare", "simulation.compare:compare", "CompareOptions",
         "Compare recorded trials with their simulation."),
        ("simulate", "simulation.simulate:simulate", "SimulateOptions",
         "Simulate any robot from any parameter file."),
    ],
    "Diagnose": [
        ("diagnose", "diagnosis.diagnose:diagnose", "DiagnoseOptions",
         "Name the unmodelled effect behind a gap between trials and simulation."),
        ("sensitivity", "sensitivity_analysis.sensitivity:sensitivity", "SensitivityOptions",
         "Rank the coefficients of a model by their effect on each output."),
    ],
    "Put to work": [
        ("map", "optimisation.performance_map:performance_map", "MapOptions",
         "Map speed, cost of transport and turning over a grid of gaits."),
        ("optimise gait", "optimisation.optimise_gait:optimise_gait", "OptimiseGaitOptions",
         "Find the best gait within limits."),
        ("optimise stiffness", "optimisation.optimise_stiffness:optimise_stiffness",
         "OptimiseStiffnessOptions",
         "Find the best stiffness of a passive joint over frequency and amplitude."),
    ],
    "Many at once": [
        ("batch", "runs.batch:batch", "BatchOptions",
         "Process many films, logs or trials files with a sequence of commands."),
        ("compare-runs", "runs.compare_runs:compare_runs", "CompareRunsOptions",
         "Compare runs, or results of one robot from several days."),
    ],
    "Publish": [
        ("export", "exporters.export:export", "ExportOptions",
         "Write coefficients and causes for MuJoCo or Gazebo, or as JSON."),
        ("plot", "kinematics.plot:plot", "PlotOptions",
         "Draw logs: channels, track from above, and spectra. Several logs are drawn over each other."),
        ("report", "results.report:report", "ReportOptions",
         "Make one self-contained page from any mixture of results."),
    ],
    "Help yourself": [
        ("doctor", "cli.commands:doctor", "DoctorOptions",
         "Check the installation: versions, video codecs, compiled kernels."),
        ("schema", "cli.commands:schema", "SchemaOptions",
         "Print the JSON Schema of a file format."),
    ],
}  # fmt: skip


@dataclass(frozen=True)
class CommandUsage:
    """Declaration of argument and output of a command (:class:`swimid.options.Options`).

    Attributes
    ----------
    output : str
        Description of the output that ``-o`` writes.
    argument : str
        Positional argument of the command, by default ``"TRIALS"``. ``"LOG..."`` stands for several files,
        ``"[NAME]"`` for an optional word, ``"[NAME] [FOLDER]"`` for a word and the output, and an empty
        string for no argument.
    output_flags : tuple of str
        Flags of the output, if they are not ``-o`` and ``--output``.
    required : bool
        Whether ``-o`` must be given.
    stdout : dict
        Default values of options if the output is a document on stdout, because ``-o`` is not given.
    beside : tuple of str
        Suffixes of the names of files that are written next to the output. The default is the suffix of the
        evidence file.
    makes : str
        Kind of file that the command makes, by which a batch connects steps: ``log``, ``parameters``,
        ``setup``, ``picture``, ``page``, or the format of a result, such as ``gap`` for ``swimid-gap/1``.
    metrics : tuple of str
        Dotted names of numbers in the ``--json`` output, which the summary of a batch shows in addition to
        the estimates. ``*`` stands for any name. After ``|`` follows the name of the 95 % interval of the
        number.
    lock : bool
        Whether the output is locked while the command runs.
    """

    output: str = ""
    argument: str = "TRIALS"
    output_flags: tuple[str, ...] = ("-o", "--output")
    required: bool = False
    stdout: Mapping[str, Any] | None = None
    beside: tuple[str, ...] = (EVIDENCE,)
    makes: str = ""
    metrics: tuple[str, ...] = ()
    lock: bool = True

    @property
    def kind(self) -> str:
        """Kind of file that the command makes, by which a batch connects steps: ``log``, ``result``, ..."""
        return self.makes if self.makes in KINDS else "result"

    @property
    def output_help(self) -> str:
        """Description of the output in the help text."""
        name = self.makes.partition("|")[0].replace("-", " ").replace("parameters", "parameter")
        return self.output or f"{name.capitalize()} file to write (YAML)."


@dataclass(frozen=True)
class CommandSpec:
    """Row of the table of commands. Its function and its class of options are imported on first use."""

    command: str
    section: str
    function: str
    options: str
    help: str

    @property
    def place(self) -> tuple[str, str]:
        """Module and name of the function that the command calls."""
        module, _, name = self.function.partition(":")
        return f"swimid.{module}", name

    def model(self) -> type[Options]:
        """Import the class of options of the command, and return this class."""
        module, _, name = self.options.rpartition(":")
        module = module or f"{self.function.partition('.')[0]}.options"
        loaded: type[Options] = getattr(importlib.import_module(f"swimid.{module}"), name)
        return loaded

    @property
    def usage(self) -> CommandUsage:
        """Argument and output of the command."""
        return self.model().usage

    def run(self) -> Any:
        """Import the function that the command calls, and return this function."""
        module, name = self.place
        return getattr(importlib.import_module(module), name)


#: All commands by name.
COMMAND_SPECS = {
    row[0]: CommandSpec(row[0], section, *row[1:]) for section, rows in TABLE.items() for row in rows
}
