"""The fish and the dolphin as tables of the compiled chain, and what may be done to their bodies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.generators import swimmer
from validation.blind.swim_engine import integrate
from validation.blind.swim_tables import EXTRA, LAWS, Chain, Water, room

SLICES = 16
#: Largest integration step, s.
STEP_S = 0.002


def law(**terms: float) -> np.ndarray:
    """A passive joint's torque; terms of `LAWS`, the play not zero because it divides."""
    row = np.zeros(len(LAWS))
    row[LAWS.index("play")] = 1e-3
    for name, value in terms.items():
        row[LAWS.index(name)] = value
    return row


@dataclass
class Body:
    """A chain before it is compiled; SI.

    ``mass_link``, ``mass_at`` and ``mass`` are points of mass, water that follows included; ``link``,
    ``behind``, ``along``, ``across`` and ``displaced`` slices of the hull; ``lateral`` rows of (link, behind,
    mass) of water that follows normal motion only; ``passive`` maps a joint to its law.
    """

    length: np.ndarray
    inertia: np.ndarray
    mass_link: np.ndarray
    mass_at: np.ndarray
    mass: np.ndarray
    link: np.ndarray
    behind: np.ndarray
    along: np.ndarray
    across: np.ndarray
    displaced: np.ndarray
    gain: np.ndarray
    passive: dict[int, np.ndarray]
    foil: np.ndarray
    lateral: list[tuple[int, float, float]] = field(default_factory=list)

    @property
    def links(self) -> int:
        return len(self.length)

    def add_mass(self, link: int, behind: np.ndarray, mass: np.ndarray) -> None:
        """Points of mass on one link."""
        self.mass_link = np.concatenate([self.mass_link, np.full(len(behind), link)])
        self.mass_at = np.concatenate([self.mass_at, behind])
        self.mass = np.concatenate([self.mass, mass])

    def chain(self) -> Chain:
        """The compiled chain's tables."""
        ahead = np.arange(self.links)[None, :] < self.mass_link[:, None]
        lever = np.where(ahead, self.length, 0.0).astype(complex)
        lever[np.arange(len(lever)), self.mass_link] = self.mass_at
        passive = np.full(self.links - 1, -1)
        for place, joint in enumerate(sorted(self.passive)):
            passive[joint] = place
        lateral = np.array(self.lateral, dtype=float).reshape(-1, 3)
        return Chain(
            self.length,
            float(self.mass.sum()),
            self.mass @ lever,
            lever.T @ (self.mass[:, None] * lever.conj()),
            self.inertia,
            passive,
            np.array([self.passive[j] for j in sorted(self.passive)]),
            self.link,
            self.behind,
            self.along,
            self.across,
            self.displaced,
            lateral[:, 0].astype(int),
            lateral[:, 1].copy(),
            lateral[:, 2].copy(),
            self.foil,
        )


def of(kind: str, coefficients: dict[str, float], slices: int = SLICES, drag_at: str = "slices") -> Body:
    """A robot of `tests.generators.swimmer`, with other coefficients."""
    if kind == "tfish":
        robot = swimmer.tfish(coefficients, slices=slices, drag_at=drag_at)
        pretension = coefficients.get("d_p", 0.030)
        passive = {3: law(spring=85.0, pretension=pretension, arm=0.032, crank=0.020)}
        foil = np.zeros(5)
    else:
        robot = swimmer.dolphin(coefficients, slices=slices)
        c = {**swimmer.DOLPHIN, **coefficients}
        passive = {2: law(linear=c["K_s"])}
        foil = np.array([0.034, 500.0 * 9.396e-3, c["cl"], c["cd0"], c["cd1"]])
    water = robot.water
    wet = (water.along > 0) | (water.across > 0)
    thick = robot.length[water.link[wet]] / np.bincount(water.link[wet])[water.link[wet]]
    if kind == "tfish":
        displaced = robot.mass[water.link[wet]] * thick / robot.length[water.link[wet]]
    else:
        height = swimmer.dolphin_height(water.link[wet], water.behind[wet])
        displaced = 1000.0 * np.pi / 4.0 * 11.0 / 12.0 * height**2 * thick
    heavy = water.mass > 0
    return Body(
        length=robot.length,
        inertia=robot.inertia.copy(),
        mass_link=np.concatenate([np.arange(len(robot.length)), water.link[heavy]]),
        mass_at=np.concatenate([robot.com, water.behind[heavy]]).astype(complex),
        mass=np.concatenate([robot.mass, water.mass[heavy]]),
        link=water.link[wet],
        behind=water.behind[wet],
        along=water.along[wet],
        across=water.across[wet],
        displaced=displaced,
        gain=robot.gain,
        passive=passive,
        foil=foil,
    )


def split_fin(body: Body, stiffness: float, damping: float) -> None:
    """Cut the fish's fin at 25 mm and join the two by a spring and damper.

    The two parts together have the fin's mass, centre of mass and moment of inertia.
    """
    last, cut = body.links - 1, 0.025
    own = body.mass_link == last
    masses = body.mass[own].sum()
    centre = float((body.mass[own] @ body.mass_at[own]).real / masses)
    rear, rear_at = 0.20 * masses, 0.066
    front_at = (masses * centre - rear * rear_at) / (masses - rear)
    spread = (masses - rear) * (front_at - centre) ** 2 + rear * (rear_at - centre) ** 2
    left = body.inertia[last] - spread
    body.mass_link, body.mass_at, body.mass = (a[~own] for a in (body.mass_link, body.mass_at, body.mass))
    body.add_mass(last, np.array([front_at + 0j]), np.array([masses - rear]))
    body.add_mass(last + 1, np.array([rear_at - cut + 0j]), np.array([rear]))
    whole = body.length[last]
    body.length = np.append(body.length[:last], [cut, whole - cut])
    body.inertia = np.append(body.inertia[:last], [0.7 * left, 0.3 * left])
    far = (body.link == last) & (body.behind > cut)
    body.link = np.where(far, last + 1, body.link)
    body.behind = np.where(far, body.behind - cut, body.behind)
    body.passive[last] = law(linear=stiffness, damping=damping, power=1.0)
    body.gain = np.append(body.gain, 0.0)


def run(
    body: Body,
    water: Water,
    joints: np.ndarray,
    step_s: float,
    start: tuple[float, float, float],
    flow: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Pose and its rate, (steps + 1, 6), and every joint's angle, (steps + 1, joints), at whole steps.

    ``joints`` (2 steps + 1, 3, joints) holds angles, rates and accelerations on the half-step grid; those of
    passive joints are not read.
    """
    chain = body.chain()
    n = 3 + len(chain.laws)
    first = np.zeros(2 * n + EXTRA)
    first[:3] = start
    if flow is None:
        flow = np.zeros(len(joints), complex)
    carried = np.gradient(flow, 0.5 * step_s)
    wide = np.zeros((len(joints), 3, body.links - 1))
    wide[:, :, : joints.shape[2]] = joints
    states = integrate(first, step_s, wide, flow, carried, chain, water, room(chain))
    angles = wide[::2, 0].copy()
    for j, p in enumerate(chain.passive):
        if p >= 0:
            angles[:, j] = states[:, 3 + p]
    return states[:, [0, 1, 2, n, n + 1, n + 2]], angles
