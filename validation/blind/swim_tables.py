"""What the compiled chain is given: its constants, what else acts, and room to work in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

WATER_KG_M3 = 1000.0
GRAVITY_M_S2 = 9.81
#: States beyond position and rate: lagged wake, shedding phase, thrust memory and its rate, bend of the fin.
EXTRA = 5
LAWS = (
    "linear",
    "cubic",
    "damping",
    "power",
    "spring",
    "pretension",
    "arm",
    "crank",
    "lock",
    "play",
    "firm",
    "bend",
)


class Chain(NamedTuple):
    """Constants of a chain; SI. Lists of points have one entry per point.

    ``moment`` and ``coupling`` are the first and second moments of all mass over the levers, ``passive``
    each joint's place among the passive ones or -1, ``laws`` their torques with columns `LAWS`; ``foil`` on
    the last link: distance behind its front end, half the density times area, C_L, C_D0 and C_D1.
    """

    length: np.ndarray
    mass: float
    moment: np.ndarray
    coupling: np.ndarray
    inertia: np.ndarray
    passive: np.ndarray
    laws: np.ndarray
    link: np.ndarray
    behind: np.ndarray
    along: np.ndarray
    across: np.ndarray
    displaced: np.ndarray
    lateral_link: np.ndarray
    lateral_behind: np.ndarray
    lateral_mass: np.ndarray
    foil: np.ndarray


class Water(NamedTuple):
    """What acts besides still, unbounded water; SI, and nothing at these values.

    ``low`` and its power: force on the nose link at low speed; ``friction``: exponent on the friction
    line; ``edge`` and ``edge_lag``: mass per length shed at the trailing edge and the time its lift takes to
    build up; ``image`` and ``image_drag``: pull and added drag of a wall at ``wall_at`` along a unit normal;
    ``torn``: share of the fin lost at ``torn_at``; ``memory``: thrust per squared speed of the fin, felt
    late; ``uneven``: the fin's force is that much larger to one side; ``bend``: of a foil's chord, rad/N;
    ``slope``: of the lift of a slice against its drag across, per rad of attack.
    """

    low: float = 0.0
    low_power: float = 1.3
    friction: float = 0.0
    friction_length: float = 0.466
    edge: float = 0.0
    edge_lag: float = 0.1
    shear: float = 0.0
    stream_x: float = 1.0
    stream_y: float = 0.0
    wave: float = 0.0
    wave_number: float = 1.0
    wave_rate: float = 1.0
    wave_phase: float = 0.0
    wave_node: float = 0.0
    line: float = 0.0
    line_span: float = 1.0
    line_drag: float = 0.0
    anchor_x: float = 0.0
    anchor_y: float = 0.0
    image: float = 0.0
    image_drag: float = 0.0
    wall_at: float = 0.0
    wall_nx: float = 0.0
    wall_ny: float = 1.0
    breach: float = 0.0
    surface: float = 0.0
    lift: float = 0.0
    righting: float = 0.0
    thrust: float = 1.0
    uneven: float = 0.0
    torn: float = 0.0
    torn_at: float = 0.0
    shed: float = 0.0
    shed_rate: float = 0.0
    memory: float = 0.0
    memory_rate: float = 1.0
    memory_damping: float = 0.5
    bend: float = 0.0
    bend_lag: float = 0.03
    slope: float = 0.0


class Work(NamedTuple):
    """Room for one evaluation."""

    e: np.ndarray
    whirl: np.ndarray
    front: np.ndarray
    speed: np.ndarray
    load: np.ndarray
    torque: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    known: np.ndarray
    matrix: np.ndarray
    right: np.ndarray
    normals: np.ndarray
    spread: np.ndarray
    reduced: np.ndarray
    answer: np.ndarray


def room(chain: Chain) -> Work:
    """`Work` for a chain; ``spread`` says which nose coordinates and links each free coordinate moves."""
    links, n = len(chain.length), 3 + len(chain.laws)
    spread = np.zeros((2 + links, n))
    spread[0, 0] = spread[1, 1] = 1.0
    spread[2:, 2] = 1.0
    for j, p in enumerate(chain.passive):
        if p >= 0:
            spread[3 + j :, 3 + p] = 1.0
    waves = (np.zeros(links, complex) for _ in range(5))
    reals = (np.zeros(links) for _ in range(4))
    rest = (np.zeros((2 + links, 2 + links)), np.zeros(2 + links), np.zeros(2 + links))
    return Work(*(*waves, *reals, *rest, spread, np.zeros((n, n)), np.zeros(n)))
