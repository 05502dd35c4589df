"""Command ``swimid export``: writes estimated coefficients in the format of a simulator."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import swimid
from swimid.errors import InputError
from swimid.exporters import gazebo, mjcf, plain
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Source
from swimid.files import atomic
from swimid.files.provenance import digests_of
from swimid.notices import warn
from swimid.options import takes
from swimid.results import parameters
from swimid.results.result import Text
from swimid.robots import file as robot
from swimid.swimmer.planar.model import MultilinkModel

#: Modules of the formats, by the name that the option ``--to`` takes.
TARGETS: dict[str, ModuleType] = {"mjcf": mjcf, "gazebo": gazebo, "json": plain}


@takes(ExportOptions)
def export(params: parameters.Source, *, options: ExportOptions, output: str | Path | None = None) -> Text:
    """Write the coefficients of a parameter file in the format of a simulator.

    The robot file that the parameter file names is searched in the folder of the parameter file. No simulator
    represents all effects: read the limits before you trust a motion that the simulator computes
    (``docs/export.md``).

    Parameters
    ----------
    params : path, ParameterFile or result of a fit
        Parameters of a robot with links in one plane.
    output : path, optional
        Path of the file to write. With None or ``-`` the text is only returned.

    Returns
    -------
    Result
        ``.document`` is the text of the file (XML or JSON), in SI units. ``.data`` has ``target``,
        ``added_mass`` and ``limits``, the effects that the format cannot represent. Each limit is also a
        warning SWM060.

    Raises
    ------
    InputError
        A file is invalid, the parameters are those of another model, or the robot file lacks a value that the
        format needs.

    Examples
    --------
    >>> import json
    >>> made = export("sample_logs/gap/params.yaml", to="json")
    >>> json.loads(made.document)["robot"], made.data["limits"]
    ('tfish', [])
    """
    chosen = TARGETS[options.to]
    source = load(params, options.robot)
    out = None if output is None or str(output) == "-" else Path(output)
    if out is not None:
        atomic.check_writable(out, inputs=[parameters.origin(params)])
    done = chosen.export(source, options)
    held = source.parameters.parameters
    unknown = [name for name, one in held.items() if one.status == "unidentifiable" and "[" not in name]
    if unknown:
        text = f"exported as they stand, though their trials do not determine them: {', '.join(unknown)}"
        warn("SWM010", text)
    for limit in done.limits:
        warn("SWM060", f"{chosen.TITLE}: {limit}")
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
    carried = "everything is carried"
    if done.limits:
        carried = f"{len(done.limits)} limits, see the warnings"
    summary = f"{source.robot.name} as {chosen.TITLE}: {carried}"
    return Text("export", summary, result, [out], document=done.text)


def load(params: parameters.Source, robot_name: str | None = None) -> Source:
    """Return parameters with the robot that they name, or with another robot given by name or file.

    Raises
    ------
    InputError
        A file is invalid, no robot is named, or the parameters are those of another robot.
    """
    path = parameters.place(params)
    file = parameters.read(params, model="multilink")
    name = robot_name or file.robot
    if name is None:
        raise InputError("names no robot", file=path, column="robot", hint="give one with --robot")
    folder = None if robot_name else path.parent
    readings = {str(key): str(value) for key, value in (file.settings.get("readings") or {}).items()}
    if robot_name:
        # the other robot file may not have all readings (interpretations) of the robot file used for the fit
        other = robot.read(name).readings
        readings = {k: v for k, v in readings.items() if k in other and v in other[k].options}
    origin = {
        "file": path.name,
        "sha256": next(iter(digests_of([parameters.origin(params)]).values())),
        "version": swimid.__version__,
        "robot": name,
    }
    source = Source(file, robot.read(name, folder, readings=readings), origin, readings)
    _check_robot(source, robot.locate(name, folder), path)
    return source


def _check_robot(source: Source, place: Path | str, path: Path) -> None:
    """Raise an error unless the robot has links, a valid mass matrix, and all coefficients of the file."""
    if source.robot.multilink is None:
        raise InputError("has no multilink part", file=place, column="multilink")
    try:
        source.assembly.check(source.values)
    except InputError as error:
        raise robot.located(error, Path(place)) from error
    known = {parameter.name for parameter in MultilinkModel(source.robot).parameters}
    known |= set(source.parameters.settings.get("shared") or {})
    for name in source.parameters.parameters:
        if name.partition("[")[0] not in known:
            raise InputError(
                f"the robot '{source.robot.name}' has no coefficient '{name}'",
                file=path,
                column=f"parameters.{name}",
                hint=f"it has: {', '.join(source.assembly.names) or 'none'}",
            )
