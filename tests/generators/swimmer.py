"""Free swimming of planar chains of links, made without the models of swimid.

The plane of motion is the complex plane, and every velocity is one in the world frame. With the
angle ``psi_k`` of link k in the world and ``e_k = exp(i psi_k)``, a point p of the chain lies at

    r_p = z - sum_k a_pk e_k

where ``z`` is the nose and the levers ``a_pk`` are constant lengths: the whole of every link ahead
of the point's own, and on its own the distance behind the front end. Lagrange's equations in
(x, y, psi_0, psi_1, ...) follow from the levers alone; the driven joints then enter as constraints.
The flow is summed over many equal slices of each link, and an adaptive Runge-Kutta method of eighth
order integrates the whole.

Three animals: ``tfish`` (Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable
Passive Tail Fin; horizontal plane), ``dolphin`` (Chen et al., Performance Optimization for Bionic
Robotic Dolphin with Active Variable Stiffness Control; vertical plane) and ``eel`` (any number of
links, every joint driven, each later than the one ahead of it).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from tests.generators import files

SLICES = 40
WATER_KG_M3 = 1000.0

#: Table III.
TFISH = {
    "c_ma": 1.15971,
    "c_Ia": 1.30205,
    "c_d0": 4.88539,
    "c_d13": 0.14055,
    "c_d4": 5.76034,
    "c_f0": 0.01229,
    "c_f13": 0.01005,
    "c_f4": 0.01020,
}
#: Table 3, a flat plate's polar for the fluke, and the softest of the published joints.
DOLPHIN = {
    "c_m0": 0.27,
    "c_m1": 0.18,
    "c_m2": 0.26,
    "c_f0": 0.039,
    "c_f1": 0.034,
    "c_f2": 0.015,
    "c_d0": 2.55,
    "c_d1": 4.0,
    "c_d2": 5.8,
    "cl": 1.2,
    "cd0": 0.08,
    "cd1": 0.84,
    "K_s": 0.31,
}
EEL = {"c_ma": 0.8, "c_Ia": 0.6, "c_d": 1.8, "c_f": 0.03}


@dataclass
class Water:
    """Points at which water acts on a chain, one entry each in every array; SI.

    ``link`` and ``behind`` (distance behind that link's front end) place it; ``along`` and ``across``
    are forces per squared speed along and normal to the link; ``mass`` is water that follows every
    motion of the point, ``lateral_mass`` water that follows its normal motion only.
    """

    link: np.ndarray
    behind: np.ndarray
    along: np.ndarray
    across: np.ndarray
    mass: np.ndarray
    lateral_mass: np.ndarray


def water(link: np.ndarray, behind: np.ndarray, **columns: np.ndarray | float) -> Water:
    """`Water` with zero for what is not given."""
    link, behind = np.asarray(link), np.asarray(behind, dtype=float)
    names = ("along", "across", "mass", "lateral_mass")
    return Water(
        link, behind, *(np.broadcast_to(columns.get(n, 0.0), link.shape).astype(float) for n in names)
    )


def joined(*parts: Water) -> Water:
    """All points of several `Water`."""
    names = ("link", "behind", "along", "across", "mass", "lateral_mass")
    return Water(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


@dataclass
class Swimmer:
    """A chain of n links from the nose backwards; SI.

    ``length``, ``mass``, ``com`` (behind the front end) and ``inertia`` (about the centre of mass) are
    per link; ``gain`` and ``lag`` (rad) are each joint's share of the drive and delay behind it.
    ``passive`` maps a joint (0 is behind link 0) to its torque as a function of its angle. ``foil`` is
    one point with a polar: its link, its distance behind that link's front end, and its force in the
    world given its velocity and the link's direction, complex all three.
    """

    length: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    inertia: np.ndarray
    water: Water
    gain: np.ndarray
    lag: np.ndarray
    passive: dict[int, Callable[[float], float]] = field(default_factory=dict)
    foil: tuple[int, float, Callable[[complex, complex], complex]] | None = None
    vertical: bool = False

    def levers(self, link: np.ndarray, behind: np.ndarray) -> np.ndarray:
        """Levers a_pk of points, shape (points, links)."""
        ahead = np.arange(len(self.length))[None, :] < link[:, None]
        lever = np.where(ahead, self.length[None, :], 0.0)
        lever[np.arange(len(link)), link] = behind
        return lever


def smoothstep(t: float, ramp_s: float) -> tuple[float, float, float]:
    """Quintic step from 0 at 0 to 1 at ``ramp_s``, and its first two derivatives."""
    if ramp_s <= 0.0 or t >= ramp_s:
        return 1.0, 0.0, 0.0
    x = t / ramp_s
    return (
        x**3 * (10.0 - 15.0 * x + 6.0 * x**2),
        30.0 * x**2 * (1.0 - x) ** 2 / ramp_s,
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp_s**2,
    )


def command(swimmer: Swimmer, drive: Mapping[str, Any], t: float) -> np.ndarray:
    """Commanded angle, rate and acceleration of every joint, shape (3, joints); rad, s.

    A sine with bias, the whole eased in by `smoothstep` over ``ramp_s`` (default 1 s).
    """
    if drive.get("waveform", "sine") != "sine":
        raise ValueError("only sine drives here")
    turn = 2.0 * np.pi * drive["frequency_hz"]
    swing = np.radians(drive["amplitude_deg"]) * swimmer.gain
    wave = turn * t - swimmer.lag
    angle = swing * np.sin(wave) + np.radians(drive.get("bias_deg", 0.0)) * swimmer.gain
    rate = turn * swing * np.cos(wave)
    bend = -(turn**2) * swing * np.sin(wave)
    step, slope, curve = smoothstep(t, drive.get("ramp_s", 1.0))
    return np.array(
        [step * angle, slope * angle + step * rate, curve * angle + 2.0 * slope * rate + step * bend]
    )


def motion(swimmer: Swimmer, drive: Mapping[str, Any]) -> Callable[[float, np.ndarray], np.ndarray]:
    """Time derivative of the state: x, y, angle of link 0, passive joints, and the rates of all these."""
    links = len(swimmer.length)
    free = sorted(swimmer.passive)
    driven = [j for j in range(links - 1) if j not in swimmer.passive]
    turned = np.tril(np.ones((links, links - 1)), -1)  # which links a joint turns
    led = turned[:, driven]
    constraint = np.zeros((2 + links, 3 + len(free)))
    constraint[0, 0] = constraint[1, 1] = constraint[2:, 2] = 1.0
    constraint[2:, 3:] = turned[:, free]
    spread = constraint[2:, 2:]
    n = constraint.shape[1]

    flow, own = swimmer.water, swimmer.water.link
    slices = swimmer.levers(own, flow.behind)
    points = np.vstack([swimmer.levers(np.arange(links), swimmer.com), slices])
    masses = np.concatenate([swimmer.mass, flow.mass])
    moment = masses @ points
    coupling = points.T @ (masses[:, None] * points)
    lateral = np.flatnonzero(flow.lateral_mass)
    if swimmer.foil is not None:
        finned, behind, polar = swimmer.foil
        fin = swimmer.levers(np.array([finned]), np.array([behind]))[0]

    def add_lateral(
        matrix: np.ndarray, e: np.ndarray, rate: np.ndarray, local: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Inertia of the laterally moved water, its inertial force on every point and moment on every link.

        From T = sum of a w^2 / 2, where w = Im(r' conj(e)) is a point's normal velocity.
        """
        where, mass = own[lateral], flow.lateral_mass[lateral]
        heading, u, w = e[where], local.real[lateral], local.imag[lateral]
        normal = np.empty((len(lateral), 2 + links))
        normal[:, 0], normal[:, 1] = -heading.imag, heading.real
        normal[:, 2:] = -slices[lateral] * (heading.conj()[:, None] * e[None, :]).real
        matrix += normal.T @ (mass[:, None] * normal)
        drift = (heading.conj() * (slices[lateral] @ (rate**2 * e))).imag - rate[where] * u
        force = np.zeros(len(own), dtype=complex)
        force[lateral] = -mass * (1j * drift - w * rate[where]) * heading
        return force, np.bincount(where, -mass * w * u, links)

    def derivative(t: float, state: np.ndarray) -> np.ndarray:
        angle, rate, known = command(swimmer, drive, t)[:, driven] @ led.T
        angle = angle + spread @ state[2:n]
        rate = rate + spread @ state[n + 2 :]
        e = np.exp(1j * angle)
        nose = state[n] + 1j * state[n + 1]

        matrix = np.zeros((2 + links, 2 + links))
        matrix[0, 0] = matrix[1, 1] = masses.sum()
        matrix[0, 2:] = matrix[2:, 0] = moment * e.imag
        matrix[1, 2:] = matrix[2:, 1] = -moment * e.real
        matrix[2:, 2:] = coupling * np.outer(e, e.conj()).real + np.diag(swimmer.inertia)

        heading = e[own]
        local = (nose - slices @ (1j * rate * e)) * heading.conj()
        u, w = local.real, local.imag
        force = -(flow.along * np.abs(u) * u + 1j * flow.across * np.abs(w) * w) * heading
        torque = np.zeros(links)
        if len(lateral):
            inertial, torque = add_lateral(matrix, e, rate, local)
            force = force + inertial
        whirl = rate**2 * e  # centripetal accelerations are levers times this
        push = force.sum() - moment @ whirl
        twist = slices.T @ force - coupling @ whirl
        if swimmer.foil is not None:
            lift = polar(nose - fin @ (1j * rate * e), e[finned])
            push += lift
            twist += fin * lift
        torque += (1j * e.conj() * twist).real
        for place, joint in enumerate(free):
            spring = swimmer.passive[joint](state[3 + place])
            torque[joint + 1] += spring
            torque[joint] -= spring
        right = np.concatenate([[push.real, push.imag], torque]) - matrix[:, 2:] @ known
        acceleration = np.linalg.solve(constraint.T @ matrix @ constraint, constraint.T @ right)
        return np.concatenate([state[n:], acceleration])

    return derivative


def sliced(length: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Link, distance behind its front end and thickness of ``count`` equal slices of every link."""
    link = np.repeat(np.arange(len(length)), count)
    behind = np.concatenate([(np.arange(count) + 0.5) * each / count for each in length])
    return link, behind, np.repeat(length / count, count)


def tfish(
    parameters: Mapping[str, float] | None = None,
    *,
    slices: int = SLICES,
    water_kg_m3: float = WATER_KG_M3,
    drag_at: str = "mid-link",
    added_mass: str = "isotropic",
    pre_tension_m: float = 0.030,
    crank_m: float = 0.020,
) -> Swimmer:
    """The tendon-driven fish: Tables I to III, Eqs 2 to 4, 6 and 7.

    ``drag_at`` is ``mid-link`` (all of a link's drag at its middle) or ``slices``; ``added_mass``
    ``isotropic`` or ``lateral``, at the centre of mass of each link. Friction acts on the areas S_y,
    normal drag on S_x; link 0's inertia is about its front end, the fin's that of a rod.
    """
    c = {**TFISH, **(parameters or {})}
    length = np.array([0.270, 0.032, 0.032, 0.032, 0.100])
    mass = np.array([2.133, 0.081, 0.081, 0.081, 0.096])
    com = np.array([0.192, 0.016, 0.016, 0.016, 0.027])
    inertia = np.array([91.6e-3 - 2.133 * 0.192**2, 0.23e-3, 0.23e-3, 0.21e-3, 0.096 * 0.100**2 / 12.0])
    side = np.array([289.09, 90.47, 90.99, 86.21, 68.53]) * 1e-4
    front = np.array([127.27, 92.89, 57.22, 37.96, 10.79]) * 1e-4
    normal = side * [c["c_d0"], c["c_d13"], c["c_d13"], c["c_d13"], c["c_d4"]]
    friction = front * [c["c_f0"], c["c_f13"], c["c_f13"], c["c_f13"], c["c_f4"]]
    link, behind, _ = sliced(length, {"mid-link": 1, "slices": slices}[drag_at])
    half = 0.5 * water_kg_m3 * len(length) / len(link)
    drag = water(link, behind, along=half * friction[link], across=half * normal[link])
    carried = {"isotropic": "mass", "lateral": "lateral_mass"}[added_mass]

    def tendon(angle: float) -> float:
        reach = np.sqrt(length[3] ** 2 + crank_m**2 - 2.0 * length[3] * crank_m * np.cos(angle))
        tension = 85.0 * (pre_tension_m + reach - length[3] + crank_m)
        return -tension * length[3] * crank_m * np.sin(angle) / reach

    return Swimmer(
        length=length,
        mass=mass,
        com=com,
        inertia=inertia * (1.0 + c["c_Ia"]),
        water=joined(drag, water(np.arange(5), com, **{carried: c["c_ma"] * mass})),
        gain=np.array([1.0, 1.0, 1.0, 0.0]) / 3.0,
        lag=np.zeros(4),
        passive={3: tendon},
    )


def dolphin_height(link: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """Height of the dolphin's body, m: elliptic nose, slow taper, quick taper to a 35 mm peduncle."""
    nose = 0.120 * np.sqrt(np.clip(1.0 - (1.0 - behind / 0.134) ** 2, 0.0, None))
    trunk = 0.120 - 0.015 * behind / 0.285
    peduncle = 0.105 - 0.070 * behind / 0.148
    return np.select([link == 0, link == 1, link == 2], [nose, trunk, peduncle], 0.0)


def dolphin(
    parameters: Mapping[str, float] | None = None,
    *,
    slices: int = SLICES,
    water_kg_m3: float = WATER_KG_M3,
    added_mass: str = "isotropic",
) -> Swimmer:
    """The robotic dolphin: Tables 1 to 3, Eqs 4, 5, 7 to 9; neck still, caudal joint a spring ``K_s``.

    Inertias are about each link's front joint; those of links 0 to 2 fix the missing centres of mass
    if the mass is spread like a rod's. The body is an ellipse 11/12 as wide as high; the fluke has no
    added mass, and the polar C_l = cl sin 2a, C_d = cd0 + cd1 (1 - cos 2a).
    """
    c = {**DOLPHIN, **(parameters or {})}
    length = np.array([0.134, 0.285, 0.148, 0.093])
    mass = np.array([0.287, 2.830, 0.662, 0.134])
    about_joint = np.array([3.207, 79.738, 3.742, 0.23]) * 1e-3
    com = np.sqrt(about_joint / mass - length**2 / 12.0)
    com[3] = 0.034
    link, behind, thickness = sliced(length[:3], slices)
    height = dolphin_height(link, behind)
    a, b = height / 2.0, height / 2.0 * 11.0 / 12.0
    perimeter = np.pi * (3.0 * (a + b) - np.sqrt((3.0 * a + b) * (a + 3.0 * b)))

    def coefficient(name: str) -> np.ndarray:
        return np.array([c[f"{name}{k}"] for k in range(3)])[link]

    carried = {"isotropic": "mass", "lateral": "lateral_mass"}[added_mass]
    body = water(
        link,
        behind,
        along=0.5 * water_kg_m3 * coefficient("c_f") * perimeter * thickness,
        across=0.5 * water_kg_m3 * coefficient("c_d") * height * thickness,
        **{carried: 0.25 * np.pi * water_kg_m3 * coefficient("c_m") * height**2 * thickness},
    )

    def fluke(velocity: complex, heading: complex) -> complex:
        speed = abs(velocity)
        attack = np.angle(velocity * heading.conjugate())
        resistance = c["cd0"] + c["cd1"] * (1.0 - np.cos(2.0 * attack))
        lift = c["cl"] * np.sin(2.0 * attack)
        return -0.5 * water_kg_m3 * 9.396e-3 * speed * velocity * complex(resistance, lift)

    return Swimmer(
        length=length,
        mass=mass,
        com=com,
        inertia=about_joint - mass * com**2,
        water=body,
        gain=np.array([0.0, 1.0, 0.0]),
        lag=np.zeros(3),
        passive={2: lambda angle: -c["K_s"] * angle},
        foil=(3, 0.034, fluke),
        vertical=True,
    )


def eel(
    parameters: Mapping[str, float] | None = None,
    *,
    slices: int = SLICES,
    water_kg_m3: float = WATER_KG_M3,
    added_mass: str = "lateral",
    links: int = 7,
    link_length_m: float = 0.09,
    link_mass_kg: float = 0.25,
    height_m: float = 0.06,
    lag_deg: float = 55.0,
) -> Swimmer:
    """Equal links, each joint driven at full amplitude ``lag_deg`` behind the one ahead of it.

    ``c_ma`` and ``c_Ia`` are added mass (at mid-link) and added inertia over those of the link;
    ``c_d`` acts on height times length and ``c_f`` on a round body's skin.
    """
    c = {**EEL, **(parameters or {})}
    length = np.full(links, link_length_m)
    mass = np.full(links, link_mass_kg)
    rod = mass * length**2 / 12.0
    link, behind, thickness = sliced(length, slices)
    half = 0.5 * water_kg_m3 * height_m * thickness
    drag = water(link, behind, along=half * np.pi * c["c_f"], across=half * c["c_d"])
    carried = {"isotropic": "mass", "lateral": "lateral_mass"}[added_mass]
    return Swimmer(
        length=length,
        mass=mass,
        com=length / 2.0,
        inertia=rod * (1.0 + c["c_Ia"]),
        water=joined(drag, water(np.arange(links), length / 2.0, **{carried: c["c_ma"] * mass})),
        gain=np.ones(links - 1),
        lag=np.radians(lag_deg) * np.arange(links - 1),
    )


KINDS: dict[str, Callable[..., Swimmer]] = {"tfish": tfish, "dolphin": dolphin, "eel": eel}


def swim(
    swimmer: Swimmer,
    drive: Mapping[str, Any],
    duration_s: float,
    *,
    rate_hz: float = 50.0,
    start: Sequence[float] | None = None,
    rtol: float = 1e-8,
) -> dict[str, np.ndarray]:
    """Columns of one run of a `Swimmer`; ``start`` is the first state of `motion`, at rest if not given."""
    time = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    n = 3 + len(swimmer.passive)
    first = np.zeros(2 * n) if start is None else np.asarray(start, dtype=float)
    run = solve_ivp(
        motion(swimmer, drive),
        (0.0, time[-1]),
        first,
        method="DOP853",
        t_eval=time,
        rtol=rtol,
        atol=1e-2 * rtol,
        max_step=0.1 / drive["frequency_hz"],
    )
    if not run.success:
        raise ArithmeticError(run.message)
    state = run.y
    joints = np.array([command(swimmer, drive, t)[0] for t in time]).T
    joints[sorted(swimmer.passive)] = state[3:n]
    body = (state[n] + 1j * state[n + 1]) * np.exp(-1j * state[2])
    up, sway, turn = ("z", "w", "pitch") if swimmer.vertical else ("y", "v", "yaw")
    return {
        "t_s": time,
        "x_m": state[0],
        f"{up}_m": state[1],
        f"{turn}_rad": state[2],
        "u_m_s": body.real,
        f"{sway}_m_s": body.imag,
        f"{turn}_rate_rad_s": state[n + 2],
        **{f"joint{k}_rad": angle for k, angle in enumerate(joints, start=1)},
    }


def simulate(
    kind: str,
    parameters: Mapping[str, float] | None,
    drive: Mapping[str, Any],
    duration_s: float,
    rate_hz: float = 50.0,
    rtol: float = 1e-8,
    **robot_options: Any,
) -> dict[str, np.ndarray]:
    """One run from rest, without noise.

    Parameters
    ----------
    kind : {"tfish", "dolphin", "eel"}
    parameters : dict or None
        Over the published ones (`TFISH`, `DOLPHIN`, `EEL`).
    drive : dict
        ``frequency_hz``, ``amplitude_deg`` (tfish: of the whole tail), and optionally ``bias_deg``,
        ``ramp_s``, as in a trials file.
    duration_s, rate_hz : float
    rtol : float
        Local error of the integration.
    robot_options
        Of the function named ``kind``.

    Returns
    -------
    dict of ndarray
        ``t_s``, pose of the nose, its velocity in the frame of link 0, and every joint's angle.
    """
    return swim(KINDS[kind](parameters, **robot_options), drive, duration_s, rate_hz=rate_hz, rtol=rtol)


@dataclass
class Run:
    """One simulated trial: what drove it, its noiseless columns, and its part in a fit."""

    id: str
    drive: dict[str, Any]
    columns: dict[str, np.ndarray]
    role: str = "fit"


def write_trials(
    folder: str | Path,
    kind: str,
    runs: Sequence[Run],
    noise: Mapping[str, float],
    seed: int,
    *,
    columns: Sequence[str] | None = None,
    robot: str | None = None,
    with_drive: bool = True,
    decimals: int | None = None,
) -> Path:
    """Write one log per run, with white noise, and the trials file over them.

    Parameters
    ----------
    folder : path
        Made if missing.
    kind : str
        The robot the trials file names, unless ``robot`` says otherwise.
    runs : list of Run
        The same runs with other seeds are repeats of one experiment.
    noise : dict
        Standard deviation of every column that has noise, SI.
    seed : int
    columns : list of str, optional
        Those to write besides ``t_s``; all if not given.
    robot : str, optional
    with_drive : bool
        Whether the trials file says what drove the joints; else the logged joints do.
    decimals : int, optional
        Of every column.

    Returns
    -------
    Path
        The trials file.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    lines = ["format: swimid-trials/1", "experiment: free-swim", f"robot: {robot or kind}", "trials:"]
    for run in runs:
        names = ["t_s", *(columns or [name for name in run.columns if name != "t_s"])]
        count = len(run.columns["t_s"])
        table = {n: run.columns[n] + noise.get(n, 0.0) * rng.standard_normal(count) for n in names}
        digits = "%.10g" if decimals is None else f"%.{decimals}f"
        head = f"# source: simulated (tests/generators/swimmer.py)\n# seed: {seed}\n"
        files.write_log(folder / f"{run.id}.csv", table, digits, head)
        lines.append(f"  - id: {run.id}\n    log: {run.id}.csv\n    role: {run.role}")
        if with_drive:
            drive = ", ".join(f"{key}: {value}" for key, value in run.drive.items())
            lines.append(f"    drive: {{{drive}}}")
    path = folder / "trials.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


#: Coefficients of the sample fish: not those of the robot file, which a fit must not merely return.
SAMPLE = {
    "c_ma": 1.0,
    "c_Ia": 1.45,
    "c_d0": 4.1,
    "c_d13": 0.35,
    "c_d4": 5.2,
    "c_f0": 0.016,
    "c_f13": 0.012,
    "c_f4": 0.011,
}
SAMPLE_NOISE = {"x_m": 0.002, "y_m": 0.002, "yaw_rad": np.radians(0.5)}


def write_sample(folder: Path) -> None:
    """Five 12 s runs of a tendon fish under a camera, one of them held out."""
    runs = []
    for name, frequency, amplitude, bias, role in (
        ("f10a20", 1.0, 20, 0, "fit"),
        ("f10a30b10", 1.0, 30, 10, "fit"),
        ("f14a25", 1.4, 25, 0, "fit"),
        ("f18a20b15", 1.8, 20, -15, "fit"),
        ("f14a20", 1.4, 20, 0, "validate"),
    ):
        drive = {"frequency_hz": frequency, "amplitude_deg": amplitude, "bias_deg": bias}
        runs.append(Run(name, drive, simulate("tfish", SAMPLE, drive, 12.0, 25.0), role))
    write_trials(folder, "tfish", runs, SAMPLE_NOISE, 20261121, columns=list(SAMPLE_NOISE), decimals=4)
