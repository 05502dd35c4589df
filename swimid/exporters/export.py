"""``export``: identified coefficients as input of a simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import swimid
from swimid.errors import InputError, UsageError
from swimid.exporters import gazebo, mjcf, plain
from swimid.exporters.common import Exported
from swimid.exporters.options import AddedMass, ExportOptions
from swimid.exporters.source import Source
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


@dataclass(frozen=True)
class Target:
    """A format to export to: the choices of added mass it has, and whether it takes one rigid body too."""

    title: str
    export: Callable[[Source, ExportOptions], Exported]
    added_mass: tuple[AddedMass, ...]
    rigid: bool


#: The targets by the name ``--to`` takes.
TARGETS = {
    "mjcf": Target("MuJoCo MJCF", mjcf.export, ("native", "fold", "none"), rigid=False),
    "gazebo": Target("Gazebo SDF", gazebo.export, ("native", "fold", "plugin", "none"), rigid=True),
    "json": Target("JSON", plain.export, ("native",), rigid=True),
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
        the lists ``limits`` and ``dangers``. Every limit is also a warning SWM060, every danger of
        instability a SWM061.

    Raises
    ------
    InputError
        For a broken file, another model, or a robot file without what the target needs.
    UsageError
        For an unknown target, and for one that cannot take this model or this added-mass choice.

    Examples
    --------
    >>> import json, swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> made = export(drag, to="json")
    >>> json.loads(made.document)["robot"], made.data["limits"]
    ('boxfish', [])
    """
    to, added_mass = options.to, options.added_mass
    target = TARGETS[to]
    if added_mass not in target.added_mass:
        raise UsageError(
            f"{to} has no added-mass choice '{added_mass}'", hint=f"there are: {', '.join(target.added_mass)}"
        )
    source = load(params, options.robot)
    if not source.multilink and not target.rigid:
        able = ", ".join(name for name, t in TARGETS.items() if t.rigid)
        raise UsageError(
            f"{to} needs a multi-link robot; this file holds the surge drag of one rigid body",
            hint=f"export it to one of: {able}",
        )
    out = None if output is None or str(output) == "-" else Path(output)
    if out is not None:
        atomic.check_writable(out, inputs=[parameters.origin(params)])
    done = target.export(source, options)
    _warn_unknown(source)
    for limit in done.limits:
        warn("SWM060", f"{target.title}: {limit}")
    for danger in done.dangers:
        warn("SWM061", f"{target.title}: {danger}")
    result = {
        "target": to,
        "model": source.parameters.model,
        "robot": source.robot.name,
        "added_mass": added_mass,
        "limits": list(done.limits),
        "dangers": list(done.dangers),
    }
    if out is None:
        return Text("export", done.text.rstrip("\n"), result | {"text": done.text}, document=done.text)
    atomic.write_text(out, done.text)
    count = len(done.limits)
    carried = (
        "everything" if not count else f"all but {count} thing{'s' if count > 1 else ''}, see the warnings"
    )
    told = f"{source.robot.name} as {target.title}: {carried}"
    return Text("export", told, result, [out], document=done.text)


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


def _warn_unknown(source: Source) -> None:
    unknown = [
        n for n, e in source.parameters.parameters.items() if e.status == "unidentifiable" and "[" not in n
    ]
    if unknown:
        warn(
            "SWM010",
            f"exported as they stand, though their trials do not determine them: {', '.join(unknown)}",
        )
