"""Command ``swimid export``, which writes estimated coefficients and causes in the format of a simulator."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import swimid
from swimid.errors import InputError, UsageError
from swimid.exporters import gazebo, mjcf, vehicle
from swimid.exporters.causes import ExportedCause, filters_text, limits_of
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Exported, ExportedLink, ExportSource, central
from swimid.files import atomic, tabular
from swimid.files.provenance import digests_of, is_own
from swimid.fitting.model import Parameter
from swimid.notices import warn
from swimid.options import takes
from swimid.results import numbers, parameters
from swimid.results.parameters import Estimate
from swimid.results.result import Text
from swimid.robots import file as robot
from swimid.simulation.catalogue import Applied, draw_parameters

FORMAT = "swimid-export/1"
#: Key of the list of force elements in the JSON document, for each kind of force element.
LISTS = {"drag": "drag_points", "foil": "foils", "force": "forces", "wake": "trailing_edges"}
CONVENTIONS = (
    "SI units and radians. A link's frame sits at its front end, x forward, y to port (up in the vertical "
    "plane). Inertias are 3x3 over (u, v, r) at the link's origin. With momentum P = G nu the wrench on a "
    "link is G nu' + (-r P_y, r P_x, u P_y - v P_x). A drag point at (x, y) feels u - r y and v + r x and "
    "answers -(quadratic |v| + linear) v along each axis and -(quadratic_r |r| + linear_r) r. A trailing "
    "edge that moves with u along and w across its link is pushed by half_mass (w^2, -2 max(u, 0) w). A "
    "joint angle is positive when the child is turned from x towards y; dry friction is friction w / "
    "sqrt(w^2 + friction_below^2) against the joint's rate w."
)


class ExportedText(Text):
    """Result of ``export``, whose ``document`` is the text of the exported file."""


@takes(ExportOptions)
def export(
    params: parameters.Source, *, options: ExportOptions, output: str | Path | None = None
) -> ExportedText:
    """Write the coefficients and causes of a parameter file in the format of a simulator.

    Causes are the effects that a diagnosis found. The robot file that the parameter file names is searched in
    the folder of the parameter file. No simulator represents all effects: read the limits before you trust a
    motion that the simulator computes (``docs/export.md``).

    Parameters
    ----------
    params : path, ParameterFile or result of a fit
        Parameters of a robot with links in one plane.
    output : path, optional
        Path of the file to write. With None or ``-`` the text is only returned. Further files are written
        beside ``tfish.xml``: ``tfish_mjcf_causes.py`` filters the commands for causes that the simulator
        cannot express, and ``tfish_draws.csv`` has the random samples.

    Returns
    -------
    Result
        ``.document`` is the text of the file (XML or JSON), in SI units. ``.data`` has ``target``,
        ``added_mass``, ``causes`` and ``limits``, the effects that the format cannot represent. Each limit is
        also a warning SWM060. If no file is written, ``filters`` is the text of the Python file that filters
        the commands, or empty.

    Raises
    ------
    InputError
        A file is invalid, the parameters are those of another model, or the robot file lacks a value that the
        format needs.
    UsageError
        Random samples are requested without an output file, or the parameters have no standard errors.
    NoTrustworthyResult
        Too few random samples lie within the bounds of the parameters.

    Examples
    --------
    >>> import json
    >>> made = export("sample_logs/gap/params.yaml", to="json")
    >>> json.loads(made.document)["robot"], made.data["limits"]
    ('tfish', [])
    """
    source = load(params)
    title, write = _format_of(source, options.to)
    out = _check_output(params, options, output)
    source, samples = _draw_samples(source, options)
    text, limits, filtered = write(source, options)
    filters = filters_text(filtered, source.model, source.origin) if filtered else ""
    _warn_of_limits(source, title, limits)
    result = _describe(source, options, limits)
    if out is None:
        texts = {"text": text, "filters": filters}
        return ExportedText("export", text.rstrip("\n"), result | texts, document=text)
    files = _write_files(out, text, filters, samples, source, options)
    summary = f"{source.robot.name} as {title}: the format carries all parts of the robot"
    if limits:
        summary = (
            f"{source.robot.name} as {title}: the format cannot carry {len(limits)} parts, see the warnings"
        )
    summary += _compare_with_mujoco(source, options, params, text, result)
    return ExportedText("export", summary, result, files, document=text)


def _describe(source: ExportSource, options: ExportOptions, limits: list[str]) -> dict[str, Any]:
    """Return the origin of an exported document and its limits, for ``--json``."""
    return {
        "target": options.to,
        "model": source.parameters.model,
        "robot": source.robot.name,
        "added_mass": options.added_mass,
        "causes": source.parameters.effects,
        "limits": limits,
    }


def _check_output(
    params: parameters.Source, options: ExportOptions, output: str | Path | None
) -> Path | None:
    """Return the path of the output, or None for the standard output; raise an error if it cannot be used."""
    if output is not None and str(output) != "-":
        return atomic.check_writable(Path(output), inputs=[parameters.origin(params)])
    if options.draws:
        text = "--draws writes a file beside the output, but no output is given"
        raise UsageError(text, hint="name it: -o FILE")
    return None


def _draw_samples(
    source: ExportSource, options: ExportOptions
) -> tuple[ExportSource, list[dict[str, float]]]:
    """Return the source with the values of the random sample that the options ask for, and the samples."""
    count = max(options.draws or 0, options.draw or 0)
    samples = _samples(source, count, options.seed) if count else []
    if options.draw:
        words = f"draw {options.draw} of seed {options.seed}"
        source = _at(source, samples[options.draw - 1], words)
    return source, samples


def _warn_of_limits(source: ExportSource, title: str, limits: list[str]) -> None:
    """Warn of parameters that are not identified, and of each effect that the format cannot represent."""
    estimates = source.parameters.parameters
    unknown = [name for name, e in estimates.items() if e.status == "unidentifiable" and "[" not in name]
    if unknown:
        names = ", ".join(unknown)
        warn(
            "SWM010", f"parameters that their trials do not determine are exported with their values: {names}"
        )
    for limit in limits:
        warn("SWM060", f"{title}: {limit}")


def _write_files(
    out: Path,
    text: str,
    filters: str,
    samples: list[dict[str, float]],
    source: ExportSource,
    options: ExportOptions,
) -> list[Path]:
    """Write the exported text, the filters of the commands and the random samples; return the files.

    Filters of an earlier export are removed if this export needs none.
    """
    files = {out: text}
    beside = out.with_name(f"{out.stem}_{options.to}_causes.py")
    if filters:
        files[beside] = filters
    if options.draws:
        table = _table(source, samples[: options.draws], options.seed)
        files[out.with_name(f"{out.stem}_draws.csv")] = table
    with atomic.write_together():
        for path, written in files.items():
            atomic.write_text(path, written)
        if not filters and beside.exists() and is_own(beside):
            atomic.remove(beside)
    return list(files)


def _compare_with_mujoco(
    source: ExportSource, options: ExportOptions, params: Any, text: str, result: dict[str, Any]
) -> str:
    """Add the difference between MuJoCo and swimid to ``result``, and return it as text; empty if unknown."""
    if options.to != "mjcf" or options.added_mass != "fold" or options.draw:
        return ""
    compared = mjcf.compare_with_mujoco(source, params, text)
    if compared is None:
        return ""
    result["compared"] = compared
    difference, way = 1e3 * compared["difference_m"], compared["way_m"]
    return f"; in MuJoCo with its callback it differs by {difference:.1f} mm after {way:.2f} m"


def _format_of(source: ExportSource, target: str) -> tuple[str, Callable[[Any, ExportOptions], Exported]]:
    """Return title and export function of a format, for a robot in a plane or in 3-D.

    Raises
    ------
    UsageError
        The format does not support robots in 3-D.
    """
    if not isinstance(source, vehicle.VehicleSource):
        return TARGETS[target]
    if target != "gazebo":
        text = f"the robot '{source.robot.name}' moves in space: --to {target} has robots in one plane"
        raise UsageError(text, hint="--to gazebo has vehicles with one link")
    return gazebo.TITLE, vehicle.export


def load(params: parameters.Source) -> ExportSource:
    """Read a parameter file and the robot file that it names, and return both as the source of an export.

    Raises
    ------
    InputError
        A file is invalid, no robot is named, or the parameters are those of another robot.
    """
    path = parameters.source_path(params)
    file = parameters.read(params, model=("multilink", "multibody"))
    kind = ExportSource
    if file.model == "multibody":
        kind = vehicle.VehicleSource
    if file.robot is None:
        hint = "write the name of a built-in robot, or the path of a robot file, to this entry"
        raise InputError("names no robot", file=path, column="robot", hint=hint)
    readings = {str(key): str(value) for key, value in (file.settings.get("readings") or {}).items()}
    origin = {
        "file": path.name,
        "sha256": next(iter(digests_of([parameters.origin(params)]).values())),
        "version": swimid.__version__,
        "robot": file.robot,
    }
    source = kind(file, robot.read(file.robot, path.parent, readings=readings), origin, path)
    _check_robot(source, robot.locate(file.robot, path.parent), path)
    return source


def _check_robot(source: ExportSource, place: Path | str, path: Path) -> None:
    """Raise an error if the robot cannot be exported with the parameters of the parameter file.

    The robot must have links in a plane, a valid mass matrix, and all coefficients of the
    parameter file.
    """
    if getattr(source.robot, source.part) is None:
        raise InputError("this part is missing; the parameters need it", file=place, column=source.part)
    try:
        source.assembly.check(source.values)
    except InputError as error:
        raise robot.add_location(error, Path(place)) from error
    known = {parameter.name for parameter in source.model.parameters}
    known |= set(source.parameters.settings.get("shared") or {})
    for name in source.parameters.parameters:
        effect, _, own = name.partition("/")
        if own and effect not in source.parameters.effects:
            raise InputError(
                f"the effect '{effect}' is missing under 'effects' of the file",
                file=path,
                column=f"parameters.{name}",
                hint=f"add effects: [{effect}]",
            )
        if not own and name.partition("[")[0] not in known:
            raise InputError(
                f"the robot '{source.robot.name}' has no coefficient '{name}'",
                file=path,
                column=f"parameters.{name}",
                hint=f"the robot has: {', '.join(source.assembly.names) or 'none'}",
            )


# ---------------------------------------------------------------- random samples

#: Fraction of random samples outside the bounds of parameters above which a warning is issued. Samples
#: outside the bounds are drawn again.
NOTABLE = 0.1


def _samples(source: ExportSource, count: int, seed: int) -> list[dict[str, float]]:
    """Draw random samples of all parameters that the trials share, according to their uncertainty.

    Each sample is a mapping of parameter names to values.

    Raises
    ------
    UsageError
        No parameter has a standard error.
    NoTrustworthyResult
        Too few samples lie within the bounds of the parameter file.
    """
    model, estimates = source.new_model(), source.parameters.parameters
    shared = {name: estimate for name, estimate in estimates.items() if "[" not in name}
    own = {p.name: p for p in model.parameters}
    effects = {
        name: Parameter(name, e.unit, e.value, e.value, e.value, 1.0)
        for name, e in shared.items()
        if "/" in name
    }
    model.parameters = tuple(_with_bounds(p, shared.get(p.name)) for p in (own | effects).values())
    # Leave out the effects of the file, because their parameters are already among those of the model.
    applied = Applied(model, source.parameters.model_copy(update={"effects": []}), source.path)
    if not applied.uncertain()[0]:
        raise UsageError(
            "no parameter of the file has a standard error, so no random samples can be drawn",
            hint="give the parameter file of a fit",
        )
    applied.warn_without_error("the random samples")
    vectors, inside = draw_parameters(applied, count, seed)
    if inside < 1.0 - NOTABLE:
        share = numbers.percent(1.0 - inside)
        warn("SWM069", f"{share} of the random samples lay outside the bounds, and were drawn again")
    index = [(name, model.index(name)) for name in shared if name in own | effects]
    return [{name: float(vector[k]) for name, k in index} for vector in vectors]


def _with_bounds(p: Parameter, estimate: Estimate | None) -> Parameter:
    """Return a copy of a parameter with the bounds of its estimate, or fixed if it has no estimate."""
    if estimate is None:
        return replace(p, free=False)
    lower, upper = estimate.limits
    return replace(p, lower=lower, upper=upper)


def _at(source: ExportSource, values: dict[str, float], words: str) -> ExportSource:
    """Return a copy of the source of an export with other values of its parameters.

    ``words`` describes the origin of the values, such as ``draw 3 of seed 1``.
    """
    estimates = dict(source.parameters.parameters)
    for name, value in values.items():
        estimates[name] = estimates[name].model_copy(update={"value": value})
    file = source.parameters.model_copy(update={"parameters": estimates})
    return replace(source, parameters=file, origin={**source.origin, "draw": words})


def _table(source: ExportSource, samples: list[dict[str, float]], seed: int) -> str:
    """Return random samples of the parameters as CSV text, with one row for each sample.

    There is one column for each parameter, with the unit in its name.
    """
    text = io.StringIO()
    text.write(f"# made_by: swimid export {source.origin['version']}\n")
    text.write(f"# parameters: {source.origin['file']}, sha256 {source.origin['sha256']}, seed {seed}\n")
    names = []
    for name in samples[0]:
        unit = source.parameters.parameters[name].unit
        # Add no unit to the names of the parameters of effects, because they end with their units.
        known = unit == "1" or "/" in name or numbers.split_unit(name)[1]
        names.append(name if known else f"{name}_{re.sub(r'[ /]', '_', unit.replace('^', ''))}")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["draw", *map(tabular.plain_text, names)])
    rows.writerows([k, *map(repr, sample.values())] for k, sample in enumerate(samples, start=1))
    return text.getvalue()


# ---------------------------------------------------------------- JSON


def _to_json(source: ExportSource, _: ExportOptions) -> Exported:
    """Return the JSON document of a multi-link robot. This format can represent all force elements."""
    file, body, links = source.parameters.model_dump(mode="json"), source.body, source.links
    data: dict[str, Any] = {
        "format": FORMAT,
        "generator": f"swimid {source.origin['version']}",
        "source": dict(source.origin),
        "model": file["model"],
        "robot": source.robot.name,
        "fluid": source.robot.fluid.model_dump(),
        **{key: file[key] for key in ("parameters", "correlation", "identifiability", "derived")},
        "causes": [_cause(cause) for cause in source.causes],
        "conventions": CONVENTIONS,
        "plane": body.plane,
        "base": body.base,
        "heading_deg": body.heading_deg,
        "reference": body.reference.model_dump(),
        "readings": {key: reading.chosen for key, reading in source.robot.readings.items()},
        "coefficients": dict(zip(source.assembly.names, source.values.tolist(), strict=True)),
        "links": [_link(link, links) for link in links],
        "actuators": {name: law.model_dump(mode="json") for name, law in body.actuators.items()},
        "joints": [_joint(source, link) for link in links[1:]],
    }
    for kind, name in LISTS.items():
        data[name] = [{"link": links[e.link].name, **e.numbers} for e in source.elements if e.kind == kind]
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return Exported(text, [*source.input_limits, *limits_of(source.causes, [], forces=True)], [])


def _cause(cause: ExportedCause) -> dict[str, Any]:
    """Return the entry of an effect in the JSON document.

    ``contained`` states whether the links, joints and force elements of the document include the influence of
    the effect.
    """
    return {
        "name": cause.name,
        "stage": cause.effect.stage,
        "meaning": cause.effect.meaning,
        "parameters": dict(cause.values),
        "contained": bool(cause.hooks.tables) and not cause.hooks.force,
    }


def _link(link: ExportedLink, links: list[ExportedLink]) -> dict[str, Any]:
    mass, centre, moment = central(link.rigid)
    parents = {i: parent.name for i, parent in enumerate(links)}
    return {
        "name": link.name,
        "parent": parents.get(link.parent),
        "length_m": link.length_m,
        "mass_kg": mass,
        "com_m": list(centre),
        "inertia_about_com_kg_m2": moment,
        # Add 0.0 to change negative zeros to 0.0.
        "rigid_inertia": (link.rigid + 0.0).tolist(),
        "added_inertia": (link.added + 0.0).tolist(),
        "apparent_inertia": (link.rigid + link.added + 0.0).tolist(),
    }


def _joint(source: ExportSource, link: ExportedLink) -> dict[str, Any]:
    assert link.joint is not None
    columns = {axis.joint.name: axis.column for axis in (*source.assembly.driven, *source.assembly.passive)}
    joint = link.joint.model_dump(mode="json")
    return {
        "name": link.joint.name,
        "column": columns.get(link.joint.name),
        "parent": source.links[link.parent].name,
        "child": link.name,
        "at_m": list(link.at),
        "mount_rad": link.mount_rad,
        "driven": joint["driven"],
        "passive": source.laws.get(link.joint.name),
    }


#: Export formats. The key is a value of the option ``--to``. Each format has its title and the function that
#: writes it.
TARGETS: dict[str, tuple[str, Callable[[ExportSource, ExportOptions], Exported]]] = {
    "mjcf": (mjcf.TITLE, mjcf.export),
    "gazebo": (gazebo.TITLE, gazebo.export),
    "json": ("JSON", _to_json),
}
