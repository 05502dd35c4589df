"""YAML in and out: comments survive, floats keep their last bit, errors name the line."""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.nodes import MappingNode, Node, SequenceNode

from swimid.errors import InputError, nearest
from swimid.files import atomic

#: A larger file is refused before it is parsed.
MAX_BYTES = 20_000_000
#: A document that expands to more nodes than this through its anchors is refused.
MAX_NODES = 500_000
#: A document nested deeper than this is refused.
MAX_DEPTH = 60

M = TypeVar("M", bound=BaseModel)


class Document(BaseModel):
    """Base of every YAML format: unknown keys are errors, values are never coerced loosely."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, validate_default=False)

    def digest(self) -> str:
        """SHA-256 of its keys and values, as hexadecimal digits; for a document that is no file."""
        return hashlib.sha256(self.model_dump_json(exclude_none=True).encode()).hexdigest()


class ResultFile(Document):
    """Base of a format that a verb writes, the default of its field ``format``."""

    #: What it is called in messages: ``"comparison file"``.
    kind: ClassVar[str]

    def write(self, path: str | Path) -> None:
        """Write the file, whole or not at all; what is not known is left out."""
        write(path, self.model_dump(mode="python", exclude_none=True))

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file of this format.

        Raises
        ------
        InputError
            When it is none.
        """
        data = of_format(path, cls.model_fields["format"].default, cls.kind)
        return validate(data, cls, Path(path))


def _known(value: Any) -> Any:
    """Arrays as lists, and nothing where a number is none."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_known(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


#: A number, or nothing where none can be had; the same in lists, rows and pairs.
Number = Annotated[float | None, BeforeValidator(_known)]
Numbers = Annotated[list[float | None], BeforeValidator(_known)]
Rows = Annotated[list[list[float | None]], BeforeValidator(_known)]
Pair = Annotated[tuple[float | None, float | None], BeforeValidator(_known)]


def _yaml() -> YAML:
    # The round-trip loader constructs plain data only, as the safe one does, and keeps
    # comments and line numbers.
    yaml = YAML(typ="rt", pure=True)
    yaml.default_flow_style = False
    yaml.width = 4096
    yaml.allow_duplicate_keys = False
    yaml.representer.add_representer(float, _represent_float)
    return yaml


def _represent_float(representer: Any, value: float) -> Any:
    # The shortest text that reads back to the same bits; with a point in it, because
    # YAML 1.1 readers take 1e-05 for a string.
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return representer.represent_scalar("tag:yaml.org,2002:float", text)


def load(path: str | Path) -> CommentedMap:
    """Read a YAML file whose top level is a mapping.

    Returns
    -------
    CommentedMap
        A ``dict`` that remembers comments and lines.

    Raises
    ------
    InputError
        When the file cannot be read, is empty, is no mapping, is broken YAML, repeats a
        key, or expands beyond reason through anchors.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        hint = "check the path" if isinstance(error, FileNotFoundError) else None
        raise InputError(f"cannot be read: {error.strerror or error}", file=path, hint=hint) from error
    if len(raw) > MAX_BYTES:
        raise InputError(f"has {len(raw)} bytes; a YAML input may have {MAX_BYTES}", file=path)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise InputError(
            "is not UTF-8 text", file=path, line=line, hint="save it as UTF-8, or is it another kind of file?"
        ) from error
    try:
        node = _yaml().compose(io.StringIO(text))
        if node is None:
            raise InputError("is empty", file=path)
        size = _expanded(node, {}, 0)
        if size > MAX_NODES:
            raise InputError(
                f"expands to more than {MAX_NODES} nodes through its anchors", file=path, hint="write it out"
            )
        data = _yaml().load(io.StringIO(text))
    except DuplicateKeyError as error:
        twice = error.problem_mark.line + 1 if error.problem_mark else None
        problem = str(error.problem or "a key stands twice").split("with value")[0].strip()
        raise InputError(problem, file=path, line=twice, hint="keep one of them") from error
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = mark.line + 1 if mark else None
        raise InputError(
            f"is not valid YAML: {error.problem or error.context}", file=path, line=place
        ) from error
    except InputError:
        raise
    except Exception as error:
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"is not valid YAML: {first}", file=path) from error
    if not isinstance(data, CommentedMap):
        raise InputError("its top level must be 'key: value' lines", file=path, line=1)
    return data


def of_format(path: str | Path, form: str, what: str) -> CommentedMap:
    """A document that says it has a format.

    Raises
    ------
    InputError
        When it does not, naming ``what`` it should be.
    """
    data = load(path)
    if data.get("format") != form:
        raise InputError(f"is no {what}: its 'format' must be {form}", file=path, line=1, column="format")
    return data


def _expanded(node: Node, known: dict[int, int], depth: int) -> int:
    """Number of nodes the document has once every alias is written out."""
    if depth > MAX_DEPTH:
        raise ValueError(f"nested more than {MAX_DEPTH} levels deep")
    if id(node) in known:
        return known[id(node)]
    known[id(node)] = MAX_NODES + 1  # a node inside itself never ends
    total = 1
    if isinstance(node, MappingNode):
        for key, value in node.value:
            total += _expanded(key, known, depth + 1) + _expanded(value, known, depth + 1)
    elif isinstance(node, SequenceNode):
        for value in node.value:
            total += _expanded(value, known, depth + 1)
    known[id(node)] = min(total, MAX_NODES + 1)
    return known[id(node)]


def validated(path: str | Path, model: type[M]) -> M:
    """Read a YAML file into a pydantic model; errors name the line and the nearest key."""
    return validate(load(path), model, path)


def validate(data: Mapping[str, Any], model: type[M], path: str | Path) -> M:
    """Check loaded data against a pydantic model.

    Raises
    ------
    InputError
        For the first thing that is wrong, with line, dotted key and what is allowed.
    """
    try:
        return model.model_validate(plain(data))
    except ValidationError as error:
        problems = error.errors()
        first = min(problems, key=lambda p: (p["type"] != "extra_forbidden", 0))
        location = _in_data(data, first)
        message, hint = _explain(first, data, model)
        places = {tuple(_in_data(data, problem)) for problem in problems}
        more = f" (and {len(places) - 1} more)" if len(places) > 1 else ""
        raise InputError(
            message + more,
            file=path,
            line=_line(data, list(first["loc"])),
            column=".".join(str(p) for p in location) or None,
            hint=hint,
        ) from error


def _in_data(data: Any, problem: Any) -> list[Any]:
    """Where a problem is, without the names of the branches of unions that pydantic puts in between."""
    found = []
    *way, last = problem["loc"] or ("",)
    for part in (*way, last):
        here = (isinstance(data, Mapping) and part in data) or (
            isinstance(data, list) and isinstance(part, int)
        )
        if here:
            data = data[part] if isinstance(data, Mapping) or part < len(data) else None
        if here or (part is last and problem["type"] == "missing"):
            found.append(part)
    return found


def _explain(problem: Any, data: Any, model: type[BaseModel]) -> tuple[str, str | None]:
    kind, location = problem["type"], problem["loc"]
    if kind == "extra_forbidden":
        unknown = str(location[-1])
        allowed = sorted(_keys_at(model, location[:-1]))
        close = nearest(unknown, allowed)
        hint = (
            f"did you mean '{close}'?"
            if close
            else f"allowed here: {', '.join(allowed)}"
            if allowed
            else None
        )
        return f"unknown key '{unknown}'", hint
    if kind == "missing":
        present = (
            [str(k) for k in _at(data, location[:-1])]
            if isinstance(_at(data, location[:-1]), Mapping)
            else []
        )
        close = nearest(str(location[-1]), present)
        return f"key '{location[-1]}' is missing", f"you wrote '{close}'" if close else None
    value = problem.get("input")
    shown = (
        repr(value) if isinstance(value, str | int | float | bool) or value is None else type(value).__name__
    )
    message = problem["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    if kind == "value_error":
        return message, None
    hint = None
    if kind in ("literal_error", "enum"):
        expected = str(problem.get("ctx", {}).get("expected", ""))
        close = nearest(str(value), [w.strip(" '") for w in expected.replace(" or ", ",").split(",")])
        hint = f"did you mean '{close}'?" if close else None
    return f"{shown} is not allowed: {message[0].lower()}{message[1:]}", hint


def _keys_at(model: Any, location: Sequence[Any]) -> set[str]:
    """Names the schema allows at a location; empty where it cannot be told."""
    schema = model.model_json_schema()
    definitions = schema.get("$defs", {})

    def resolve(node: dict[str, Any]) -> list[dict[str, Any]]:
        if "$ref" in node:
            return resolve(definitions[node["$ref"].rsplit("/", 1)[-1]])
        branches = [*node.get("anyOf", []), *node.get("oneOf", [])]
        return [leaf for branch in branches for leaf in resolve(branch)] if branches else [node]

    nodes = resolve(schema)
    for part in location:
        following: list[dict[str, Any]] = []
        for node in nodes:
            if isinstance(part, int):
                following += resolve(node["items"]) if isinstance(node.get("items"), dict) else []
            elif part in node.get("properties", {}):
                following += resolve(node["properties"][part])
            elif isinstance(node.get("additionalProperties"), dict):
                following += resolve(node["additionalProperties"])
        nodes = following or nodes
    return {name for node in nodes for name in node.get("properties", {})}


def _at(data: Any, location: Sequence[Any]) -> Any:
    for part in location:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return data
    return data


def _line(data: Any, location: list[Any]) -> int | None:
    """Line of the deepest part of ``location`` the document really has."""
    line = None
    for part in location:
        positions = getattr(data, "lc", None)
        try:
            if isinstance(data, Mapping) and part in data and positions is not None:
                line = positions.key(part)[0] + 1
                data = data[part]
            elif isinstance(data, list) and isinstance(part, int) and part < len(data):
                line = positions.item(part)[0] + 1 if positions is not None else line
                data = data[part]
        except (KeyError, TypeError, AttributeError):
            return line
    return line


def plain(value: Any) -> Any:
    """The same data as plain Python dicts, lists, strings and numbers; numpy included."""
    if isinstance(value, BaseModel):
        return plain(value.model_dump(mode="python"))
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return plain(value.tolist())
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, float):
        return float(value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, str):
        return str(value)
    if isinstance(value, Path):
        return value.as_posix()
    return value


def dumps(data: Mapping[str, Any]) -> str:
    """YAML text of a mapping; short leaf mappings and number lists stand on one line."""
    stream = io.StringIO()
    _yaml().dump(_styled(plain(data), 0), stream)
    return stream.getvalue()


def _styled(value: Any, depth: int) -> Any:
    from ruamel.yaml.comments import CommentedSeq

    if isinstance(value, dict):
        styled = CommentedMap((k, _styled(v, depth + 1)) for k, v in value.items())
        leaves = [v for v in value.values() if isinstance(v, dict | list)]
        if depth > 1 and value and all(_short_list(v) for v in leaves) and len(str(value)) < 150:
            styled.fa.set_flow_style()
        return styled
    if isinstance(value, list):
        sequence = CommentedSeq(_styled(v, depth + 1) for v in value)
        if not any(isinstance(v, dict) for v in value) and len(str(value)) < 150:
            sequence.fa.set_flow_style()
        return sequence
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _short_list(value: Any) -> bool:
    return isinstance(value, list) and not any(isinstance(v, dict | list) for v in value)


def write(path: str | Path, data: Mapping[str, Any]) -> None:
    """Write a mapping as YAML, whole or not at all."""
    atomic.write_text(path, dumps(data))


def dumps_flat(data: Mapping[str, Any]) -> str:
    """YAML of a mapping with every value on its key's line."""
    stream = io.StringIO()
    yaml = _yaml()
    yaml.default_flow_style = None
    styled = CommentedMap()
    for key, value in plain(data).items():
        styled[key] = _flow(value)
    if styled:
        yaml.dump(styled, stream)
    return stream.getvalue()


def _flow(value: Any) -> Any:
    from ruamel.yaml.comments import CommentedSeq

    if isinstance(value, dict):
        mapping = CommentedMap((k, _flow(v)) for k, v in value.items())
        mapping.fa.set_flow_style()
        return mapping
    if isinstance(value, list):
        sequence = CommentedSeq(_flow(v) for v in value)
        sequence.fa.set_flow_style()
        return sequence
    return value


def parse_scalar(text: str) -> Any:
    """The value of one ``key: value`` line.

    Raises
    ------
    ValueError
        When it is not YAML.
    """
    try:
        return plain(YAML(typ="safe", pure=True).load(text.strip()))
    except Exception as error:
        raise ValueError((str(error) or "unreadable").splitlines()[0]) from error
