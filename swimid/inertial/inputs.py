"""The record of an inertial unit, and another log of the trial to fuse it with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.files.provenance import path_of
from swimid.files.tabular import missing_column
from swimid.inertial.alignment import Poses
from swimid.inertial.record import (
    ACCELERATION,
    MAGNETIC,
    QUATERNION,
    RATE,
    Array,
    Record,
    rotations,
)
from swimid.logs import log, mapping, tracks
from swimid.logs.log import Log
from swimid.logs.mapping import Mapping
from swimid.logs.rotation import angles
from swimid.logs.sampling import usual_step
from swimid.notices import warn
from swimid.progress import Progress

#: Fewest samples that make a motion.
FEWEST_SAMPLES = 64
#: A track of fewer samples, or of samples farther apart, s, is too sparse to tell jumps from motion.
FEWEST_FOR_JUMPS, SPARSE_S = 40, 0.25
#: No tank is larger, m: a mark for "no sample".
FARTHEST_M = 1e4


def read_record(
    given: Path | Log, rules: Mapping | None, named: Path, progress: Progress
) -> tuple[Record, list[str]]:
    """The record as it stands in the file or table, faults and all, and what to know of how it was read.

    ``named`` is what says which column is which: the mapping, or the recording itself.

    Raises
    ------
    InputError
        The file or the mapping cannot be used, or a column is missing.
    """
    path = path_of(given)
    mapped = mapping.apply(rules, given, progress=progress)
    columns = mapped.columns
    for name in (*ACCELERATION, *RATE):
        if name not in columns:
            raise missing_column(name, list(columns), named, None, "an inertial log needs this column")
    if len(mapped) < FEWEST_SAMPLES:
        text = f"has {len(mapped)} samples; at least {FEWEST_SAMPLES} are needed"
        raise InputError(text, file=path)

    def together(names: tuple[str, ...]) -> Any:
        return np.column_stack([columns[name] for name in names]) if set(names) <= set(columns) else None

    record = Record(
        columns[log.TIME],
        together(ACCELERATION),
        together(RATE),
        together(QUATERNION),
        together(MAGNETIC),
        metadata=mapped.metadata,
        name=path.name,
    )
    return record, mapped.notes


def read_poses(read: Log) -> Poses:
    """Positions and angles of another log; bridged samples count as missing.

    Where a log keeps what was measured beside what was smoothed (``x_raw_m``), the measured is taken.

    Raises
    ------
    InputError
        It holds neither positions nor angles.
    """
    bridged = np.zeros(len(read), dtype=bool)
    if "found" in read:
        bridged |= read["found"] == 0
    if "interpolated" in read:
        bridged |= read["interpolated"] == 1

    def channel(name: str, unit: str) -> Array:
        column = next((c for c in (f"{name}_raw_{unit}", f"{name}_{unit}") if c in read), None)
        return np.full(len(read), np.nan) if column is None else np.where(bridged, np.nan, read[column])

    position = np.column_stack([channel(axis, "m") for axis in "xyz"])
    turn = np.column_stack([channel(name, "rad") for name in ("roll", "pitch", "yaw")])
    if all(name in read for name in QUATERNION):
        q = np.column_stack([read[name] for name in QUATERNION])
        there = np.isfinite(q).all(axis=1) & (np.linalg.norm(q, axis=1) > 0.5) & ~bridged
        turn[:] = np.nan
        if there.any():
            turn[there] = np.column_stack(angles(rotations(q[there])))
    if not np.isfinite(position).any() and not np.isfinite(turn).any():
        raise InputError(
            "holds neither a position (x_m, y_m, z_m) nor an angle (roll_rad, "
            "pitch_rad, yaw_rad) to fuse with",
            file=read.path,
            hint="tracks in pixels need a scale in their setup",
        )
    _take_out(read, position, turn)
    measured = np.isfinite(turn)
    turn[measured[:, 2], 2] = np.unwrap(turn[measured[:, 2], 2])
    if not measured.any(axis=0).all():
        alone = 2 if measured[:, 2].any() else 1
        turn[:, np.arange(3) != alone] = np.nan
    return Poses(read.time_s, position, turn)


def _take_out(read: Log, position: Array, turn: Array) -> None:
    """Empty the samples of a dense track that repeat a picture or jump away from it."""
    far = (np.abs(position) > FARTHEST_M).any(axis=1)
    position[far] = np.nan
    repeated, jumped = np.zeros_like(far), far
    seen = np.flatnonzero(np.isfinite(position).any(axis=0))
    if len(read) >= FEWEST_FOR_JUMPS and usual_step(read.time_s) <= SPARSE_S and len(seen) > 1:
        cleaning = tracks.clean(read.time_s, [position[:, k] for k in seen], list(turn.T))
        repeated, jumped = cleaning.repeated, far | cleaning.jumped
    out = repeated | jumped
    if out.any():
        position[out] = turn[out] = np.nan
        warn(
            "SWM058",
            f"{read.path.name}: {int(repeated.sum())} repeated and {int(jumped.sum())} stray samples left "
            "out of the track",
        )
