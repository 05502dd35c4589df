"""Generate the parts of reference pages that the code states: file formats, warnings and effects.

The formats come from the pydantic classes of the files, with their docstrings and the ``#:`` comments of
their fields. Warnings come from ``swimid/warnings.toml``, effects from their classes. ``python -m
docs.evidence`` writes the parts into their pages, between two comments.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from swimid.cli import commands
from swimid.effects.base import STAGES
from swimid.effects.catalogue import list_effects
from swimid.logs.experiments import find_experiments
from swimid.notices import read_warnings
from swimid.results.result import class_of, list_result_formats

#: Title of each generated part of a format. The classes of the entries with the keys, or of the elements with
#: the kinds, that follow it stand in this part, and so do the classes of their own entries.
PARTS: dict[str, Sequence[str]] = {
    "Links, joints and elements": ("multilink",),
    "Inputs": ("inputs", "torque", "load"),
    "Propellers, rudders and derivatives": ("propeller", "rudder", "derivatives", "moving-mass"),
    "Transmissions": ("actuators", "driven"),
    "On a load cell": ("holder",),
    "A robot in space": ("multibody",),
}
#: Meaning of keys that have the same meaning in all formats, for classes that do not describe them.
COMMON = {
    "format": "Name and version of the format, the mark of the file.",
    "robot": "Name of a built-in robot, or path of a robot file relative to this file.",
    "model": "Name of the model.",
    "experiment": "Name of the experiment.",
    "params": "Parameter file.",
    "trials": "The trials.",
    "verdict": "Verdict of the command.",
    "provenance": "Command, version, time, settings, and SHA-256 of each input.",
    "unit": "Unit.",
    "value": "Value, in the unit.",
    "stderr": "Standard error, in the unit.",
    "bounds": "Lower and upper bound; null for none.",
    "status": "Status: `estimated`, `fixed`, `at-bound` or `unidentifiable`.",
    "name": "Name.",
    "title": "Title.",
    "caption": "Caption.",
    "meaning": "Meaning in words.",
    "source": "Source of the value.",
    "link": "Name of the link on which the element acts.",
    "input": "Name of the input that acts.",
    "at_m": "Place on the link, m: station in a plane, three coordinates in space.",
    "offset_m": "Distance to port of the axis of the link (upwards in the vertical plane), m.",
    "parent": "Name of the link that carries the joint.",
    "child": "Name of the link that the joint moves.",
    "elements": "Forces of the water and others on the links.",
    "links": "Rigid links, the base first.",
    "joints": "Joints, in the order of the columns `joint1_rad`, `joint2_rad`, ...",
    "coefficients": "Coefficients by name, which quantities may contain.",
    "inputs": "Columns of the log that act on the robot, by name.",
    "holder": "Holder between a fixed base and a load cell.",
    "reference": "Point whose pose the log holds.",
    "markers": "Points of the base that a camera follows, by name.",
    "metres_per_pixel": "Scale, m.",
    "rmse": "Root-mean-square error, in the unit.",
    "nrmse": "Root-mean-square error over the measured range.",
    "start_s": "Start of the part of the log that is used, s.",
    "end_s": "End of the part of the log that is used, s; by default the end of the log.",
    "drive": "Commanded beat, or stroke of the robot file.",
    "stroke": "Name of a stroke of the robot file.",
    "frequency_hz": "Frequency of the beat, Hz.",
    "amplitude_deg": "Amplitude of the beat, degrees.",
    "ramp_s": "Time in which the motion grows from rest to its full size, s.",
    "phase_deg": "Phase of the motion at time zero, degrees.",
    "table": "Table of cruising speeds, relative to this file.",
    "drag": "Parameter file of `fit-drag` for the same robot, relative to this file.",
    "output": "Column of the log that the model simulates.",
    "parameters": "Parameters, by name.",
    "inertial_mass_kg": "Mass of the body, without added mass, kg.",
    "frontal_area_m2": "Frontal area, to which the drag coefficient refers, m².",
    "fluid_density_kg_m3": "Density of the water in this trial, kg/m³.",
    "pulling_mass_kg": "Mass of the falling weight, kg.",
    "driving_force_N": "Constant driving force along `x_m`, in place of a falling weight, N.",
    "description": "Description of the robot.",
    "sources": "References.",
    "fluid": "Water and gravity.",
    "body": "Properties of the robot as one rigid body.",
    "rig": "Test rig.",
    "fins": "Caudal fins, by name.",
    "theory": "Theoretical values of parameters, with which reports compare.",
    "density_kg_m3": "Density of the water, kg/m³.",
    "gravity_m_s2": "Acceleration of gravity, m/s².",
    "length_m": "Length, m.",
    "width_m": "Width, m.",
    "height_m": "Height, m; of a fin its span.",
    "roll_inertia_kg_m2": "Moment of inertia in roll, without added inertia, kg m².",
    "pitch_inertia_kg_m2": "Moment of inertia in pitch, without added inertia, kg m².",
    "yaw_inertia_kg_m2": "Moment of inertia in yaw, without added inertia, kg m².",
    "pulley_inertia_kg": "Moment of inertia of the pulley divided by its radius squared, kg.",
    "encoder_resolution_m": "Resolution of the measured displacement, m.",
    "stiffness_N_m": "Stiffness of the spring that holds the robot along its path, N/m.",
    "roll_stiffness_N_m_rad": "Stiffness of the spring that holds the robot in roll, N m/rad.",
    "pitch_stiffness_N_m_rad": "Stiffness of the spring that holds the robot in pitch, N m/rad.",
    "yaw_stiffness_N_m_rad": "Stiffness of the spring that holds the robot in yaw, N m/rad.",
    "pitch_gravity_stiffness_N_m_rad": "Stiffness of the restoring moment of gravity in pitch, N m/rad.",
    "shape": "Shape of the fin.",
    "axle_gap_m": "Distance from the axle to the leading edge of the fin, m.",
    "area_m2": "Area, m²; in space a drag has one along each axis of the link.",
    "hydrodynamic_inertia_kg_m2": "Moment of inertia of the entrained water about the axle, kg m².",
    "parameter": "Name of the parameter.",
    "basis": "Basis of the value: theory, table or assumption.",
    "question": "Ambiguous statement in the source.",
    "chosen": "Name of the chosen interpretation.",
    "options": "Possible interpretations, by name.",
    "says": "Description of the interpretation.",
    "plane": "Plane of the motion.",
    "base": "Whether the first link moves freely or is fixed.",
    "station_m": "Distance behind the front end of the link, m.",
    "natural_frequency_hz": "Natural frequency, Hz.",
    "damping_ratio": "Damping ratio.",
    "power": "Exponent of the law.",
    "lag_s": "Time constant of the lag, s.",
    "bias_gain": "Factor applied to the bias of the drive; by default `gain`.",
    "servo": "Servo that follows the commanded angle; by default the command is followed exactly.",
    "max_rate_deg_s": "Maximum absolute rate that may be commanded, degrees/s.",
    "mass_kg": "Mass, kg; in an element its added mass along each axis, unless it is a moving mass.",
    "com_m": "Position of the centre of mass in the axes of the link, m.",
    "com_offset_m": "Distance of the centre of mass to port of the axis of the link, m.",
    "inertia_kg_m2": "Moment of inertia, kg m²; in an element the added moment of inertia.",
    "driven": "Law of the joint if it is driven.",
    "passive": "Law of the moment in the joint if it is passive.",
    "torque": "Torque of an input on the passive joint.",
    "stiffness_N_m_rad": "Stiffness of the spring, N m/rad.",
    "cubic_N_m_rad3": "Moment of the spring in proportion to the cubed angle, N m/rad³.",
    "damping_N_m_s_rad": "Linear damping, N m s/rad.",
    "quadratic_damping_N_m_s2_rad2": "Quadratic damping, N m s²/rad².",
    "friction_below_rad_s": "Joint rate below which dry friction is smoothed, rad/s.",
    "rest_deg": "Angle at which the spring has no moment, degrees.",
    "tendon": "Wire with a spring.",
    "spring_N_m": "Stiffness of the spring of the wire, N/m.",
    "pretension_m": "Extension of the spring at zero angle, m.",
    "arm_m": "Length l_3 in Eqs 3 and 4 of the tendon fish paper, m.",
    "crank_m": "Length l_ps in Eqs 3 and 4 of the tendon fish paper, m.",
    "surge_kg": "Added mass for motion along the link, kg.",
    "sway_kg": "Added mass for motion across the link, kg.",
    "axial_area_m2": "Reference area of the drag along the link, m².",
    "axial_coefficient": "Drag coefficient along the link.",
    "normal_area_m2": "Reference area of the drag across the link, m².",
    "normal_coefficient": "Drag coefficient across the link.",
    "normal_linear_N_s_m": "Linear drag of the whole element for motion across the link, N s/m.",
    "from_m": "Station at which the strips begin, m; by default the front end of the link.",
    "to_m": "Station at which the strips end, m; by default the rear end of the link.",
    "linear_N_s_m": "Linear drag along each axis of the link, N s/m.",
    "linear_N_m_s_rad": "Linear damping, N m s/rad; in space one about each axis.",
    "quadratic_N_m_s2_rad2": "Quadratic damping, N m s²/rad²; in space one about each axis.",
    "added_mass_coefficient": "Factor applied to the added mass of a cylinder of the same height.",
    "friction_coefficient": "Coefficient of the friction along the link, on the perimeter of the section.",
    "drag_coefficient": "Coefficient of the drag across the link, on the height of the section.",
    "added_mass_direction": "Motions with added mass: both axes of the link, or only normal to it.",
    "strips": "Number of strips on which the element acts.",
    "perimeter_m": "Perimeter, m.",
    "lift_coefficient": "Coefficient `lift` of the polar.",
    "drag_coefficient_0": "Coefficient `drag0` of the polar.",
    "drag_coefficient_1": "Coefficient `drag1` of the polar.",
    "volume_m3": "Volume of the water that is displaced or enclosed, m³.",
    "buoyancy_at_m": "Station of the centre of buoyancy, m; by default the centre of mass.",
    "buoyancy_offset_m": "Distance of the centre of buoyancy to port (upwards in the vertical plane), m.",
    "half_height_m": "Half the height of the band about the water surface in which the element fades out, m.",
    "frame": "Axes of the force.",
    "forward_N": "Force along x, N.",
    "port_N": "Force along y, to port (upwards in the vertical plane), N.",
    "force_N": "Force along each axis, N; in a load for an input of 1.",
    "moment_N_m": "Moment for an input of 1, N m.",
    "diameter_m": "Diameter, m.",
    "wake_port": "C_2 of `wake_decay` for motion of the propeller to port.",
    "wake_starboard": "C_2 of `wake_decay` for motion of the propeller to starboard.",
    "semi_minor_m": "Half of the short axis, m.",
    "span_m": "Span, m.",
    "chord_m": "Chord, m.",
    "chord": "Direction of the chord, in the axes of the link.",
    "normal": "Direction normal to the surface, in the axes of the link.",
    "strokes": "Strokes, by name.",
    "period_s": "Period of the stroke, s.",
    "angles_deg": "Angles of each hinge at the knots, degrees.",
    "tail": "Name of the tail marker.",
    "camera": "Calibration of the camera.",
    "hsv": "Range of the colour, for the method `colour`.",
    "number": "Number of markers of this kind.",
    "area_px": "Minimum and maximum area in the picture, px.",
    "hue_deg": "Lower and upper end of the hue, degrees.",
    "saturation": "Minimum and maximum saturation.",
    "points_px": "Positions of known points in the picture, px.",
    "points_m": "Coordinates of the same points, m.",
    "distance_m": "Distance of the two points, m.",
    "heights": "Heights above the plane of the scale, if the markers are not in it.",
    "camera_m": "Height of the camera, m.",
    "marker_m": "Height of the markers, m.",
    "matrix": "Camera matrix `[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]`, px.",
    "distortion": "Coefficients of the lens distortion, in the order of OpenCV.",
    "reader": "Layout of the file.",
    "quaternion": "Convention of the quaternions.",
    "decimal": "Decimal mark.",
    "encoding": "Encoding of a text file.",
    "order": "Order of the elements.",
    "direction": "Direction of the rotation.",
    "target": "Name of the column in the log, which ends in its unit.",
    "factor": "Factor applied after the conversion of the unit.",
    "duration_s": "Duration of each simulation from rest, s.",
    "axes": "Axes of the grid.",
    "quantities": "Quantities, by name.",
    "quantity": "Name of the quantity.",
    "vary": "Range of each varied parameter.",
    "low": "Lower end of the range.",
    "high": "Upper end of the range.",
    "limits": "Limits, by name.",
    "at_most": "Upper limit; null for none.",
    "at_least": "Lower limit; null for none.",
    "best": "Value of the goal at the best gait.",
    "inside": "Fraction of the drawn samples that lay within the bounds of the coefficients.",
    "unsettled": "Number of simulations in which the speed still changes at the end.",
}
#: Names of types in JSON Schema, as the tables show them.
TYPES = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
LIMITS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in lines)


def marked(text: str) -> str:
    """Turn the marks of a docstring into those of Markdown."""
    text = re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", text)
    return re.sub(r"``(.+?)``", r"`\1`", text)


# ---------------------------------------------------------------- descriptions of fields


@cache
def comments(kind: type) -> dict[str, str]:
    """Return the comment ``#:`` above each field in the source of one class."""
    try:
        lines = textwrap.dedent(inspect.getsource(kind)).splitlines()
    except (OSError, TypeError):  # A class that was made at run time.
        return {}
    (node,) = ast.parse("\n".join(lines)).body
    texts = {}
    for field in getattr(node, "body", []):
        if isinstance(field, ast.AnnAssign):
            start = end = field.lineno - 1
            while lines[start - 1].strip().startswith("#:"):
                start -= 1
            words = [line.strip().removeprefix("#:").strip() for line in lines[start:end]]
            texts[ast.unparse(field.target)] = " ".join(words)
    return texts


def split_docstring(kind: type) -> tuple[str, str, dict[str, str]]:
    """Return the prose of a class's docstring, its example, and the descriptions of its attributes."""
    own = next((base for base in kind.__mro__ if base.__dict__.get("__doc__")), kind)
    text = inspect.getdoc(own) or ""
    prose, _, attributes = text.partition("\nAttributes\n----------\n")
    prose, _, example = prose.partition("\nExample::\n")
    described = {}
    for names, body in re.findall(r"^(\w[\w, ]*?) : .*\n((?:    .*\n?)*)", attributes, re.M):
        for name in names.split(", "):
            described[name] = " ".join(body.split())
    return prose.strip(), textwrap.dedent(example).strip("\n"), described


def describe_fields(kind: type[BaseModel]) -> dict[str, str]:
    """Return the description of each field of a class, also of those that it inherits."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, BaseModel) and base is not BaseModel:
            found = {**split_docstring(base)[2], **comments(base)}
            texts |= {name: text for name, text in found.items() if text}
    for name, field in kind.model_fields.items():
        texts.setdefault(name, field.description or COMMON.get(name, ""))
    return texts


def name_type(schema: Mapping[str, Any]) -> str:
    """Return the type of a value in words, from its JSON Schema."""
    if "anyOf" in schema or "oneOf" in schema:
        parts = [name_type(part) for part in schema.get("anyOf", schema.get("oneOf"))]
        return " or ".join(dict.fromkeys(part for part in parts if part != "null"))
    if "enum" in schema or "const" in schema:
        return ", ".join(f"`{value}`" for value in schema.get("enum", [schema.get("const")]))
    kind = schema.get("type", "mapping" if "$ref" in schema else "any")
    if kind == "array":
        items = schema.get("prefixItems")
        inner = dict.fromkeys(map(name_type, items)) if items else [name_type(schema.get("items", {}))]
        count = f"{len(items)} values: " if items else "list: "
        return count + ", ".join(inner)
    if kind == "object":
        values = schema.get("additionalProperties")
        return f"mapping: {name_type(values)}" if isinstance(values, dict) else "mapping"
    limits = " and ".join(f"{sign} {schema[key]:g}" for key, sign in LIMITS.items() if key in schema)
    return f"{TYPES.get(kind, kind)} {limits}".strip()


def show_default(schema: Mapping[str, Any], required: bool) -> str:
    """Return the default of a field, as a table shows it."""
    value = schema.get("default")
    if required:
        return "required"
    if value is None or value in ("", [], {}) or isinstance(value, dict):
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


# ---------------------------------------------------------------- classes of a format


def classes_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the pydantic classes in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from classes_in(part)


def constant(kind: type[BaseModel], name: str) -> str:
    """Return the only value that a field of a class may have; empty if it may have several."""
    annotation = kind.model_fields[name].annotation if name in kind.model_fields else None
    values = get_args(annotation) if get_origin(annotation) is Literal else ()
    return str(values[0]) if len(values) == 1 else ""


def entries(annotation: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], type[BaseModel]]]:
    """Yield each class in a type with the keys that lead to it, and then the classes of its own fields."""
    for kind in classes_in(annotation):
        word = constant(kind, "kind") or constant(kind, "experiment")
        here = (*path, word) if word else path
        yield here, kind
        for name, field in kind.model_fields.items():
            yield from entries(field.annotation, (*here, name))


def class_text(path: Sequence[str], kind: type[BaseModel]) -> Iterator[str]:
    """Yield the prose, the example and the table of keys of one class."""
    prose, example, _ = split_docstring(kind)
    word = constant(kind, "kind") or constant(kind, "experiment")
    key = f"`{path[-2]}`, `{word}`" if word and len(path) > 1 else f"`{path[-1]}`" if path else ""
    yield f"**{key}.** {marked(prose)}\n" if key else f"{marked(prose)}\n"
    if example:
        yield from ("```yaml", example, "```\n")
    texts, schema = describe_fields(kind), kind.model_json_schema(by_alias=True)
    rows = []
    for name, field in kind.model_fields.items():
        shown = field.alias or name
        if constant(kind, name) and name in ("kind", "experiment"):
            continue
        about = schema["properties"][shown]
        row = [f"`{shown}`", name_type(about), show_default(about, field.is_required()), marked(texts[name])]
        rows.append([cell.replace("|", "\\|") for cell in row])
    yield table(["key", "value", "default", "meaning"], rows) + "\n"


def format_text(title: str, annotation: Any, level: int) -> Iterator[str]:
    """Yield the Markdown text of one file format, each class once, divided into the parts of its keys."""
    parts: dict[str, list[str]] = {title: []}
    shown: set[type[BaseModel]] = set()
    for path, kind in entries(annotation):
        if kind not in shown:
            shown.add(kind)
            part = title
            for key in path:
                found = next((name for name, keys in PARTS.items() if key in keys), part)
                part = part if part == "A robot in space" else found
            parts.setdefault(part, []).extend(class_text(path, kind))
    for name in [title, *(name for name in PARTS if name in parts)]:
        yield f"{'#' * (level if name == title else level + 1)} {name}\n"
        yield from parts[name]


#: Title of the format of each file that people write, and of each file that commands write.
WRITTEN_BY_HAND = {
    "trials": "Trials file", "robot": "Robot file", "setup": "Setup file", "mapping": "Mapping",
    "points": "Points file",
}  # fmt: skip
WRITTEN_BY_COMMANDS = {
    "parameters": "Parameter file", "gap": "Gap file", "power": "Power file", "comparison": "Comparison file",
    "sensitivity": "Sensitivity file", "map": "Map file", "rule": "Rule file", "gait": "Gait file",
    "run-comparison": "Comparison of runs", "camera": "Camera file", "evidence": "Evidence",
}  # fmt: skip


def formats_text(titles: Mapping[str, str]) -> str:
    """Return the Markdown text of several file formats."""
    lines: list[str] = []
    for name, title in titles.items():
        kind = class_of(name).file_type if name in list_result_formats() else find_class(name)
        text = "\n".join(format_text(title, kind, 3))
        # Only robot files have quantities, which are numbers or products with coefficients.
        lines.append(text.replace("number or text", "quantity") if name == "robot" else text)
    return "\n".join(lines).rstrip("\n")


def experiments_text() -> str:
    """Return the table of all experiments with the columns that their logs or tables need."""
    rows = []
    for title, kind in sorted(find_experiments().items()):
        groups = [" or ".join(f"`{name}`" for name in group) for group in kind.usual]
        rows.append(
            [f"`{title}`", kind.about, ", and ".join(groups), ", ".join(f"`{c}`" for c in kind.commands)]
        )
    return table(["experiment", "trials", "columns that a log or table has", "fitted by"], rows)


def find_class(name: str) -> Any:
    """Return the class, or the type, of a format that no command writes."""
    module, _, attribute = commands.OTHERS[name].partition(":")
    found = getattr(import_module(module), attribute)
    return found if isinstance(found, type) else found()


# ---------------------------------------------------------------- public names

#: Title of each page of the Python reference, and the public names on it.
PYTHON = {
    "Start": ("init", "sample", "robot"),
    "Trials, logs and robots": (
        "load", "read_log", "read_robot", "list_robots", "TrialSet", "Log", "Robot",
    ),
    "Make logs": (
        "track_video", "track_setup", "track_camera", "Calibration", "track_imu", "import_log",
        "guess_mapping", "plot", "Logged",
    ),
    "Identify": ("fit_drag", "fit_propulsion", "fit_graybox", "rwls", "fit", "Fitted"),
    "Simulate and compare": ("simulate", "Simulation", "compare", "Comparison"),
    "Diagnose": ("diagnose", "Diagnosis", "DetectionPower", "sensitivity", "Sensitivity"),
    "Put to work": (
        "performance_map", "PerformanceMap", "optimise_stiffness", "StiffnessRule", "optimise_gait",
        "BestGait",
    ),
    "Many at once": ("batch", "Batch", "compare_runs", "ComparedRuns"),
    "Results": ("load_result", "Result", "report", "export"),
    "Models and effects": ("Model", "Parameter", "Channel", "Trial", "Trials", "fit_model", "Effect"),
    "Errors and warnings": (
        "SwimidError", "InputError", "UsageError", "NoTrustworthyResult", "SwimidWarning",
    ),
}  # fmt: skip


def names_text() -> str:
    """Return the table of the public names."""
    rows = [[title, ", ".join(f"`{name}`" for name in names)] for title, names in PYTHON.items()]
    return table(["subject", "names"], rows)


# ---------------------------------------------------------------- warnings and effects


def warnings_text() -> str:
    """Return the list of all warnings, by subject."""
    lines: list[str] = []
    for title, texts in read_warnings().items():
        lines += [f"## {title}\n"]
        lines += [f'- <a id="{code}"></a>**{code}** {text}' for code, (_, text) in texts.items()] + [""]
    return "\n".join(lines).rstrip("\n")


def effects_text() -> str:
    """Return the table of all effects, by the stage of the simulation on which they act."""
    rows, names = [], set()
    for stage in STAGES:
        first = stage
        for effect in sorted(list_effects(), key=lambda effect: effect.name):
            if effect.stage == stage and effect.name not in names:
                names.add(effect.name)
                rows.append([first, f"`{effect.name}`", effect.meaning])
                first = ""
    return table(["stage", "effect", "meaning"], rows)
