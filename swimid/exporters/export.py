"""``export``: identified coefficients as input of a simulator."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import swimid
from swimid.errors import InputError, UsageError
from swimid.exporters import gazebo, mjcf, plain
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Exported, Source
from swimid.files import atomic
from swimid.files.provenance import digest_of
from swimid.notices import warn
from swimid.options import takes
from swimid.results import parameters
from swimid.results.result import Text
from swimid.robots import file as robot
from swimid.swimmer.planar.model import MultilinkModel

#: Models whose parameters can be exported.
RIGID = ("falling-weight", "towed")
MODELS = ("multilink", *RIGID)


#: The targets by the name ``--to`` takes: what each is called, and what makes its text.
TARGETS: dict[str, tuple[str, Callable[[Source, ExportOptions], Exported]]] = {
    "mjcf": ("MuJoCo MJCF", mjcf.export),
    "gazebo": ("Gazebo SDF", gazebo.export),
    "json": ("JSON", plain.export),
}


@takes(ExportOptions)
def export(params: parameters.Source, *, options: ExportOptions, output: str | Path | None = None) -> Text:
    """Write a parameter file's coefficients as a simulator reads them.

    The robot the parameter file names is looked for beside that file. No simulator carries everything: see
    the limits before trusting a motion it computes (``docs/export.md``).

    Parameters
    ----------
    params : path, ParameterFile or result of a fit
        Parameters of a multi-link robot, a falling weight or a towed body.
    output : path, optional
        The file to write. None or ``-`` gives the text only.

    Returns
    -------
    Result
        ``.document`` is the text (XML, or JSON), in SI units; ``.data`` has ``target``, ``added_mass`` and
        ``limits``. Every limit is also a warning SWM060.

    Raises
    ------
    InputError
        For a broken file, another model, or a robot file without what the target needs.
    UsageError
        For a target that cannot take this model.

    Examples
    --------
    >>> import json, swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> made = export(drag, to="json")
    >>> json.loads(made.document)["robot"], made.data["limits"]
    ('boxfish', [])
    """
    title, make = TARGETS[options.to]
    source = load(params, options.robot)
    if not source.multilink and options.to == "mjcf":
        raise UsageError(
            "mjcf needs a multi-link robot; this file holds the surge drag of one rigid body",
            hint="export it to gazebo or json",
        )
    out = None if output is None or str(output) == "-" else Path(output)
    if out is not None:
        atomic.check_writable(out, inputs=[parameters.origin(params)])
    done = make(source, options)
    names = source.parameters.parameters
    unknown = [n for n, e in names.items() if e.status == "unidentifiable" and "[" not in n]
    if unknown:
        warn(
            "SWM010",
            f"exported as they stand, though their trials do not determine them: {', '.join(unknown)}",
        )
    for limit in done.limits:
        warn("SWM060", f"{title}: {limit}")
    result = {
        "target": options.to,
        "model": source.parameters.model,
        "robot": source.robot.name,
        "added_mass": options.added_mass,
        "limits": list(done.limits),
    }
    if out is None:
        return Text("export", done.text.rstrip("\n"), result | {"text": done.text}, document=done.text)
    atomic.write_text(out, done.text)
    carried = f"{len(done.limits)} limits, see the warnings" if done.limits else "everything is carried"
    return Text("export", f"{source.robot.name} as {title}: {carried}", result, [out], document=done.text)


def load(params: parameters.Source, robot_name: str | None = None) -> Source:
    """Parameters with their robot.

    Raises
    ------
    InputError
    """
    path, given = parameters.place(params), parameters.origin(params)
    file = parameters.read(params, model=MODELS)
    name = robot_name or file.robot
    if name is None:
        raise InputError("names no robot", file=path, column="robot", hint="give one with --robot")
    folder = None if robot_name else path.parent
    chosen = file.settings.get("readings")
    readings = {str(k): str(v) for k, v in chosen.items()} if isinstance(chosen, dict) else {}
    if robot_name:
        # another file may lack the readings of the one the parameters were found with
        other = robot.read(name).readings
        readings = {k: v for k, v in readings.items() if k in other and v in other[k].options}
    robot_file = robot.read(name, folder, readings=readings)
    place = robot.locate(name, folder)
    origin = {
        "file": path.name,
        "sha256": digest_of(given),
        "version": swimid.__version__,
        "robot": name,
    }
    source = Source(file, robot_file, origin, readings)
    if source.multilink:
        if robot_file.multilink is None:
            raise InputError("has no multilink part", file=place, column="multilink")
        try:
            source.assembly.check(source.values)
        except InputError as error:
            raise robot.located(error, place) from error
        _check_names(source, path)
    return source


def _check_names(source: Source, path: Path) -> None:
    """Refuse parameters that the robot has no use for: they are another robot's."""
    known = {p.name for p in MultilinkModel(source.robot).parameters}
    known |= set(source.parameters.settings.get("shared") or {})
    for name in source.parameters.parameters:
        if name.partition("[")[0] not in known:
            raise InputError(
                f"the robot '{source.robot.name}' has no coefficient '{name}'",
                file=path,
                column=f"parameters.{name}",
                hint=f"it has: {', '.join(source.assembly.names) or 'none'}",
            )
