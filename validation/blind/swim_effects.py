"""Hidden causes in the structure, the water and around the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from validation.blind import swim_actuation
from validation.blind.swim_body import Body, split_fin
from validation.blind.swim_case import Act, Trial
from validation.blind.swim_tables import LAWS


@dataclass(frozen=True)
class Typical:
    """Sizes of a robot that make a cause of size 1 clearly visible; SI."""

    passive: int
    stiffness: float
    damping: float
    shed_mass: float
    linear: float
    current: float
    wave: float
    line: float
    wall: float


TYPICAL = {
    "tfish": Typical(3, 0.012, 0.002, 0.8, 0.4, 0.004, 0.007, 0.06, 0.015),
    "dolphin": Typical(2, 0.06, 0.006, 0.5, 0.5, 0.018, 0.005, 0.045, 0.008),
}


def _law(body: Body, robot: str, **terms: float) -> None:
    row = body.passive[TYPICAL[robot].passive]
    for name, value in terms.items():
        row[LAWS.index(name)] = value if name in ("power", "play", "bend") else row[LAWS.index(name)] + value


# ---------------------------------------------------------------- structure


def fin_flexibility(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The fish's fin bends at a second, stiff joint; the dolphin's by its load, a little late."""
    if robot == "dolphin":
        bend = {"bend": 0.05 * size, "bend_lag": rng.uniform(0.02, 0.04)}
        return Act(water=lambda trial: bend)
    stiffness = 0.12 / size * rng.uniform(0.8, 1.25)

    def body(trial: Trial, b: Body) -> None:
        split_fin(b, stiffness, 0.01 * stiffness)

    return Act(body=body)


def joint_stiffness(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A hardening or softening spring on the passive joint."""
    sign = 1.0 if size > 2 else rng.choice([-1.0, 1.0])
    more = sign * size * TYPICAL[robot].stiffness

    def body(trial: Trial, b: Body) -> None:
        _law(b, robot, linear=0.6 * more, cubic=4.0 * abs(more))

    return Act(body=body)


#: Stiffness of the passive joint at small angles, N m/rad, and how far it bends, rad.
SPRING = {"tfish": (85.0 * 0.030 * 0.032 * 0.020 / 0.012, 0.35), "dolphin": (0.31, 0.12)}


def hardening(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A spring whose torque goes with the hyperbolic sine of its angle."""
    stiffness, usual = SPRING[robot]
    bend = np.sqrt(6.0 * 0.4 * size) / usual

    def body(trial: Trial, b: Body) -> None:
        _law(b, robot, firm=stiffness, bend=bend)

    return Act(body=body, facts={"hardening_rad_2": bend**2 / 6.0})


def joint_damping(rng: np.random.Generator, size: float, robot: str) -> Act:
    def body(trial: Trial, b: Body) -> None:
        _law(b, robot, damping=size * TYPICAL[robot].damping, power=1.3)

    return Act(body=body)


def joint_locked(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The passive joint jams but for a little play; or one of the fish's servos stays where it is."""
    if robot == "tfish" and size >= 1.0 and rng.random() < 0.4:
        return swim_actuation.held_joint(rng)
    stiffness, play = {"tfish": 0.10, "dolphin": 0.15}[robot] * size**1.5, np.radians(rng.uniform(0.3, 1.0))

    def body(trial: Trial, b: Body) -> None:
        _law(b, robot, lock=stiffness, play=play)

    return Act(body=body)


def water_ingress(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Water along the rear of the hull's largest link, trimmed so that nothing sinks."""
    link = 0 if robot == "tfish" else 1
    share = np.array([0.1, 0.2, 0.3, 0.4]) * rng.uniform(0.8, 1.2, 4)
    mass = {"tfish": 0.80, "dolphin": 1.20}[robot] * size * share

    def body(trial: Trial, b: Body) -> None:
        where = b.length[link] * np.array([0.45, 0.6, 0.75, 0.9])
        b.add_mass(link, where.astype(complex), mass)
        b.inertia = b.inertia.copy()
        b.inertia[link] += mass.sum() * (0.1 * b.length[link]) ** 2

    return Act(body=body)


def com_offset(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The hull's centre of mass lies farther ahead or behind, and a little to one side."""
    link = 0 if robot == "tfish" else 1
    shift = size * {"tfish": 0.030, "dolphin": 0.040}[robot] * rng.choice([-1.0, 1.0])
    aside = 0.15 * abs(shift) * rng.uniform(-1.0, 1.0)

    def body(trial: Trial, b: Body) -> None:
        b.mass_at = b.mass_at.copy()
        b.mass_at[link] += complex(shift, aside)

    return Act(body=body)


def fin_tear(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The fin loses area in the midst of one trial and stays so."""
    torn, lost = int(rng.integers(2, 5)), min({"tfish": 0.2, "dolphin": 0.06}[robot] * size, 0.85)

    def water(trial: Trial) -> dict[str, float]:
        if trial.index < torn:
            return {}
        when = trial.rng("tear").uniform(0.3, 0.6) * trial.duration_s
        return {"torn": lost, "torn_at": when if trial.index == torn else -10.0}

    return Act(water=water)


def spring_drift(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A spring that softens and stiffens with the day's temperature."""
    path = size * TYPICAL[robot].stiffness * 2.0 * (rng.uniform(-1.0, 1.0, 12))

    def body(trial: Trial, b: Body) -> None:
        _law(b, robot, linear=path[trial.index])

    return Act(body=body)


# -------------------------------------------------------------------- fluid


def linear_drag(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Resistance that grows with a power of speed between one and two."""
    water = {"low": size * TYPICAL[robot].linear, "low_power": rng.uniform(1.0, 1.35)}
    return Act(water=lambda trial: water)


def drag_reynolds(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The friction line of ITTC-1957, steeper for larger sizes."""
    water = {"friction": size, "friction_length": {"tfish": 0.466, "dolphin": 0.66}[robot]}
    return Act(water=lambda trial: water)


def added_mass(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Water that follows only sideways, more of it towards the tail."""
    extra = 0.30 * size * rng.uniform(0.8, 1.2)

    def body(trial: Trial, b: Body) -> None:
        for k in range(len(b.gain) + 1):
            per = extra * (1.0 if robot == "tfish" else (1.2 if k else 0.6))
            for x in (0.2113, 0.7887):
                b.lateral.append((k, x * b.length[k], per * b.length[k] * (0.7 + 0.3 * k)))

    return Act(body=body)


def wake_lift(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Reactive force at the trailing edge, its sideways part behind a first-order wake."""
    water = {"edge": size * TYPICAL[robot].shed_mass, "edge_lag": rng.uniform(0.05, 0.15)}
    return Act(water=lambda trial: water)


def lift_damping(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Lift of every slice that levels off towards large angles of attack."""
    slope = {"tfish": 0.3, "dolphin": 0.3}[robot] * size
    return Act(water=lambda trial: {"slope": slope}, facts={"slope": slope})


def vortex_shedding(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Alternate shedding behind the hull at Strouhal's frequency."""
    water = {
        "shed": size * {"tfish": 0.25, "dolphin": 0.1}[robot],
        "shed_rate": 2.0 * np.pi * rng.uniform(0.18, 0.24) / 0.107,
    }
    return Act(water=lambda trial: water)


def wake_memory(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Thrust in step with how hard the fin beat a second ago."""
    gain = {"tfish": 0.12, "dolphin": 0.08}[robot] * size
    water = {"memory": gain, "memory_rate": rng.uniform(0.8, 1.5), "memory_damping": rng.uniform(0.15, 0.3)}
    return Act(water=lambda trial: water)


def spread_drag(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Drag along each link instead of half-way along it; a size of 1 is the whole length."""
    share = (np.arange(16) + 0.5) / 16 - 0.5

    def body(trial: Trial, b: Body) -> None:
        places = b.behind[:, None] + size * share * b.length[b.link][:, None]
        b.behind = places.ravel()
        b.link, b.along, b.across, b.displaced = (
            np.repeat(a, 16) for a in (b.link, b.along / 16, b.across / 16, b.displaced / 16)
        )

    return Act(body=body)


def asymmetric_thrust(rng: np.random.Generator, size: float, robot: str) -> Act:
    uneven = min(0.05 * size, 0.6) * rng.choice([-1.0, 1.0])
    return Act(water=lambda trial: {"uneven": uneven})


# -------------------------------------------------------------- environment


def current(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A stream with shear across it that slowly swells and fades."""
    speed = size * TYPICAL[robot].current
    stream = np.exp(1j * rng.uniform(-np.pi, np.pi)) if robot == "tfish" else complex(rng.choice([-1.0, 1.0]))
    shear = 0.15 * speed * rng.uniform(-1.0, 1.0)

    def flow(trial: Trial, t: np.ndarray) -> np.ndarray:
        own = trial.rng("current")
        found = np.ones_like(t, dtype=complex)
        for frequency in (0.04, 0.09, 0.17):
            found += 0.06 * own.normal() * np.cos(2 * np.pi * (frequency * t + own.random()))
            found += 0.04j * own.normal() * np.cos(2 * np.pi * (frequency * t + own.random()))
        return speed * stream * found

    return Act(
        flow=flow, water=lambda trial: {"shear": shear, "stream_x": stream.real, "stream_y": stream.imag}
    )


def waves(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A standing wave of the pool: its place the same in every trial, its phase not."""
    stream = np.exp(1j * rng.uniform(-np.pi, np.pi)) if robot == "tfish" else 1.0 + 0j
    fixed = {
        "wave": size * TYPICAL[robot].wave,
        "wave_number": 2.0 * np.pi / rng.uniform(5.0, 9.0),
        "wave_rate": 2.0 * np.pi * rng.uniform(0.3, 0.6),
        "wave_node": rng.uniform(0.0, 2.0 * np.pi),
        "stream_x": stream.real,
        "stream_y": stream.imag,
    }
    return Act(water=lambda trial: {**fixed, "wave_phase": trial.rng("waves").uniform(0.0, 2.0 * np.pi)})


def gusts(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Bursts of water from anywhere at any time."""
    peak = size * {"tfish": 0.006, "dolphin": 0.004}[robot]

    def flow(trial: Trial, t: np.ndarray) -> np.ndarray:
        own = trial.rng("gusts")
        found = np.zeros_like(t, dtype=complex)
        for _ in range(own.poisson(3) + 1):
            width, turn = own.uniform(0.4, 1.2), own.uniform(-np.pi, np.pi)
            where = own.uniform(0.0, trial.duration_s)
            found += peak * own.uniform(0.4, 1.0) * np.exp(-(((t - where) / width) ** 2) + 1j * turn)
        return found

    return Act(flow=flow)


def tether(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A light line from behind where the run starts: sag pulls it tight, and the wet length drags."""
    line, off = size * TYPICAL[robot].line, rng.uniform(0.3, 0.8)

    def water(trial: Trial) -> dict[str, float]:
        anchor = complex(*trial.start[:2]) - off * trial.heading
        return {
            "line": line,
            "line_span": 2.0,
            "line_drag": 0.5 * line,
            "anchor_x": anchor.real,
            "anchor_y": anchor.imag,
        }

    return Act(water=water)


def wall(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A wall along x: the image of the hull pulls, and the gap adds drag."""
    pull = size * TYPICAL[robot].wall

    def start(trial: Trial, own: np.random.Generator) -> None:
        away = np.radians(own.uniform(-2.0, 8.0)) if robot == "tfish" else np.radians(own.uniform(1.0, 5.0))
        trial.start = (trial.start[0], own.uniform(0.25, 0.5), away)
        if "bias_deg" in trial.drive:  # turns away
            trial.drive["bias_deg"] = -abs(trial.drive["bias_deg"])

    fixed = {
        "image": pull,
        "image_drag": {"tfish": 0.01, "dolphin": 0.004}[robot] * size,
        "wall_nx": 0.0,
        "wall_ny": 1.0,
        "wall_at": 0.0,
    }
    return Act(water=lambda trial: fixed, start=start)


def surface_breach(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Sections above the surface have weight and no water around them; larger sizes swim nearer to it."""
    depth = 0.105 - 0.03 * np.log10(size / 0.3)

    def start(trial: Trial, own: np.random.Generator) -> None:
        trial.start = (trial.start[0], -depth - own.uniform(0.0, 0.02), np.radians(own.uniform(-1.5, 0.5)))

    fixed = {"breach": 1.0, "surface": 0.0}
    return Act(water=lambda trial: fixed, start=start)


def buoyancy(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Net lift ahead of the middle, and the righting moment of a low centre of mass."""
    lift = 0.012 * size * rng.choice([-1.0, 1.0])
    return Act(water=lambda trial: {"lift": lift, "righting": 0.04 * size})
