"""Options of the commands ``swimid init`` and ``swimid sample``."""

from __future__ import annotations

from swimid.options import Options, option


class InitOptions(
    Options,
    argument="FOLDER",
    output="Folder of the project to write. Without it, what was found is only listed.",
    beside=(),
    lock=False,
):
    """Look at a folder of films, logs and tables, and draft the files to work with them.

    The project has a setup for each camera, a mapping or a points file for each kind of table, a trials file,
    a robot file, a plan for `swimid batch`, and a README with the questions and the next commands. What the
    recordings do not state is ASK in these files. A command refuses a file in which an ASK is left.

    Examples:
      swimid init recordings
      swimid init recordings -o project
      swimid init recordings -o project --robot tfish --experiment free-swim
    """

    robot: str | None = option(None, metavar="NAME|FILE", help="Robot of the trials, built in or a file.")
    experiment: str | None = option(
        None, metavar="NAME|FILE", help="Experiment of the trials, or the Python file of one's own."
    )


class SampleOptions(
    Options,
    argument="[NAME] [FOLDER]",
    output="The folder to write, in place of FOLDER.",
    beside=(),
    lock=False,
):
    """Copy sample recordings of the installed version to a folder.

    Without NAME, list the samples. The default folder is named like the sample. Recordings of other authors
    are downloaded from their repository, at a stated commit. Their SHA-256 is checked, and their licence and
    citation are written beside them.

    Examples:
      swimid sample
      swimid sample rig my-rig
      swimid sample fishsim fish --from downloads
    """

    address: str | None = option(
        None,
        flag="--from",
        metavar="ADDRESS",
        help="Folder or address of a server that has the recordings of other authors. Default: the "
        "environment variable SWIMID_DOWNLOADS, else their repository.",
    )


class RobotOptions(
    Options,
    argument="FILE",
    output="Robot file to write. Without it, the draft is only described.",
    beside=(),
    lock=False,
):
    """Draft a robot file from a file in MJCF or URDF.

    FILE is a model of MuJoCo or a URDF of a robot that moves in a plane. The draft has its links, joints,
    springs, servos and sites. If the file has a fluid, forces of the water are drafted with wide bounds. What
    the file does not state is asked in comments. Without water, both models are simulated and compared.

    Examples:
      swimid robot fish.xml -o robot.yaml
      swimid robot arm.urdf --fixed -o arm.yaml
    """

    density: float | None = option(
        None, ge=0, metavar="KG_M3", help="Density of the water, kg/m3. Default: that of the file."
    )
    fixed: bool = option(False, help="Hold the root of a URDF in place.")
