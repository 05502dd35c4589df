"""Options of the commands ``swimid import``, ``swimid schema`` and ``swimid doctor``."""

from __future__ import annotations

from swimid.imports.options import ImportOptions
from swimid.options import Options, option


class ImportLogOptions(
    ImportOptions,
    argument="FILE",
    output="The log, CSV or Parquet by its ending; with --guess the mapping.",
    makes="log",
    metrics=(
        "stroke.frequency_hz|stroke.ci95_hz",
        "speed.path_m_s|speed.path_ci95",
        "speed.line_m_s|speed.line_ci95",
    ),
):
    """Import a log of a tracker, of motion capture, of a robot or of a laboratory, or any table.

    A mapping says which source column becomes which column of the log, and in which unit it was
    written. Without one the columns must have the names of the log format already. With --robot, points
    that a tracker followed on its links become pose and joint angles. Beside the log goes its evidence
    (<stem>.evidence.json).

    Examples:
      swimid import field.csv --guess -o map.yaml
      swimid import field.csv --map map.yaml -o run.csv
      swimid import filmDLC.csv --rate-hz 60 --robot tfish --points points.yaml -o run.csv
      swimid import STATES1.txt --map docs/examples/msu-states.yaml -o run1.csv
    """

    guess: bool = option(
        False,
        recorded=False,
        help="Draft a mapping instead, with ASK for everything that the file does not state.",
    )


class DoctorOptions(Options, argument="", output="Write the findings as JSON to this file.", beside=()):
    """Check the installation: versions, video codecs, compiled kernels.

    Examples:
      swimid doctor --warm-up
      swimid doctor --clean
    """

    warm_up: bool = option(False, help="Compile the numerical kernels now, so that no later run waits.")
    clean: bool = option(False, help="Remove the compiled kernels, as before swimid is uninstalled.")


class SchemaOptions(
    Options, argument="[NAME]", output="Write the schema to this file instead of stdout.", beside=()
):
    """Print the JSON Schema of a file format.

    Without NAME, list the formats.

    Example:
      swimid schema trials > trials.schema.json
    """
