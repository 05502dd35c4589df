"""Reader of COCO keypoints (JSON): annotations of pictures, or the results of a pose estimator.

An annotation has x, y and v of each keypoint, in pixels from the upper left corner, with y down. The reader
converts the coordinates to y up. In annotations v is 0 for a point that is not labelled, and 1 or 2 for a
labelled point. In results (a list) v is the score of the point. The number at the end of the file name of a
picture is its frame; if the names have no numbers that differ, the id of the picture is its frame. COCO
states no frame rate.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.imports.formats.keypoints import points
from swimid.imports.table import Array, ForeignTable, Format, Peek, ReaderOptions, choose

#: Keys under which annotation tools write the number of a tracked individual.
_TRACK = ("track_id", "instance_id", "object_id")


def _recognises(peek: Peek) -> bool:
    if peek.head.lstrip()[:1] not in (b"{", b"["):
        return False
    try:
        content = json.loads(peek.path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError):  # let the reader refuse a damaged file
        return b'"image_id"' in peek.head or (b'"images"' in peek.head and b'"file_name"' in peek.head)
    return bool(_annotations(content))


def _annotations(content: Any) -> list[dict[str, Any]]:
    """Return the annotations with keypoints in the content of a file; empty if it is not COCO."""
    found = content
    if isinstance(content, dict):
        found = content.get("annotations")
    if not isinstance(found, list):
        return []
    return [one for one in found if isinstance(one, dict) and "image_id" in one and one.get("keypoints")]


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    content = json.loads(path.read_text(encoding="utf-8-sig"))
    found = _annotations(content)
    if not found:
        hint = "each annotation must have the keys image_id and keypoints"
        raise InputError("holds no COCO keypoints", file=path, hint=hint)
    named = content if isinstance(content, dict) else {}
    categories = {one["id"]: one for one in named.get("categories", [])}
    tracks: dict[str, list[dict[str, Any]]] = {}
    for one in found:
        tracks.setdefault(_track(one, categories), []).append(one)
    chosen = tracks[choose(select, list(tracks), "individual", path)]
    at = _find_frames(chosen, named.get("images", []), path)
    lists = [one["keypoints"] for one in chosen]
    widths = set(map(len, lists))
    if len(widths) > 1 or max(widths) % 3:
        text = f"annotations have {', '.join(map(str, sorted(widths)))} values; each must have x, y and v"
        raise InputError(text, file=path)
    cells = np.array(lists, dtype=float)[np.argsort(at)]
    cells = cells.reshape(len(cells), -1, 3)
    names = categories.get(chosen[0].get("category_id"), {}).get("keypoints") or []
    if len(names) != cells.shape[1]:
        names = [f"point{k}" for k in range(1, cells.shape[1] + 1)]
    columns: dict[str, Array] = {}
    for k, name in enumerate(names):
        x, y, visible = cells[:, k].T
        columns[f"{name}.x"] = np.where(visible > 0, x, np.nan)
        columns[f"{name}.y"] = np.where(visible > 0, y, np.nan)
        if isinstance(content, list):
            columns[f"{name}.score"] = visible
    return ForeignTable({"frame": np.sort(at).astype(float), **points(columns)})


def _find_frames(annotations: list[dict[str, Any]], images: list[dict[str, Any]], path: Path) -> Any:
    """Return the frame of each annotation of one individual.

    Raises
    ------
    InputError
        The frames are unknown, or two annotations are in one picture.
    """
    frames = _frames(images)
    at = np.array([frames.get(one["image_id"], one["image_id"]) for one in annotations])
    if at.dtype.kind not in "iu":
        text = f"the frame of the image_id '{max(map(str, at))}' is unknown"
        raise InputError(text, file=path, hint="number image_id, or each file_name under 'images'")
    values, counts = np.unique(at, return_counts=True)
    if (counts > 1).any():
        text = f"{counts.max()} individuals in one picture have no numbers to distinguish them"
        hint = f"each annotation needs one of the keys {', '.join(_TRACK)}"
        raise InputError(text, file=path, frame=int(values[np.argmax(counts)]), hint=hint)
    return at


def _track(annotation: dict[str, Any], categories: dict[Any, dict[str, Any]]) -> str:
    """Return the name of the individual to which an annotation belongs: its track, or its category."""
    stated = annotation | (annotation.get("attributes") or {})
    track = next((stated[key] for key in _TRACK if key in stated), None)
    if track is not None:
        return str(track)
    kind = annotation.get("category_id")
    return str(categories.get(kind, {}).get("name", kind))


def _frames(images: list[dict[str, Any]]) -> dict[Any, Any]:
    """Return the frame of each picture, by its id."""
    numbers = {one["id"]: re.findall(r"\d+", Path(str(one.get("file_name"))).stem)[-1:] for one in images}
    frames = {key: int(number[0]) for key, number in numbers.items() if number}
    if len(set(frames.values())) == len(images):
        return frames
    return {key: key for key in numbers}


PROFILE = Format("coco", "COCO keypoints file", _read, _recognises)
