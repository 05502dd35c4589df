"""Quaternions in another order or of the other direction: quaternion rates against the gyroscope."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import strapdown
from swimid.inertial.faults.base import BLOCK_S, Finding
from swimid.inertial.faults.rate_unit import CLEARLY
from swimid.inertial.record import Array, Record, rotations
from swimid.logs.rotation import rearranged

NAME = "quaternions"
#: Fewest windows that tell.
FEWEST = 16


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Compare the turns of the quaternions with those of the gyroscope; leave them aside if they contradict.

    Each order of the elements, with each direction, is tried. A convention that leaves less than half of the
    difference that the one in the log leaves is named.
    """
    if record.quaternion is None:
        return record, []
    size = max(round(BLOCK_S / record.step_s), 1)
    sensed = _turns(strapdown.attitude(record.time_s, record.rate, Rotation.identity())[::size])
    if len(sensed) < FEWEST:
        return record, []
    every = record.quaternion[::size]
    left = {}
    for order, direction in product(("wxyz", "xyzw"), ("body-to-world", "world-to-body")):
        told = _turns(rotations(rearranged(every, order, direction)))
        left[order, direction] = float(np.sum((told - sensed) ** 2))
    as_is = left["wxyz", "body-to-world"]
    order, direction = min(left, key=lambda name: left[name])
    if left[order, direction] >= CLEARLY * as_is:
        return record, []
    power = float(np.sum(sensed**2))
    stated = [f"order: {order}"] * (order != "wxyz") + [f"direction: {direction}"] * (
        direction != "body-to-world"
    )
    text = (
        f"the quaternions turn otherwise than the gyroscope: as wxyz from body to world they differ by "
        f"{100 * as_is / power:.0f} % of its turning, as {order} from {direction.replace('-', ' ')} by "
        f"{100 * left[order, direction] / power:.0f} %; they are not used. State their convention in a "
        f"mapping (--map) with the line 'quaternion: {{{', '.join(stated)}}}'"
    )
    return replace(record, quaternion=None), [Finding(NAME, "refuted", text)]


def _turns(rotation: Rotation) -> Array:
    """Return the turns from each attitude to the next about body axes, rad, shape (n - 1, 3)."""
    return np.asarray((rotation[:-1].inv() * rotation[1:]).as_rotvec())
