"""Lagrange's equations of a planar tree of links, derived from its energies by CasADi.

Not a model of swimid. A robot file's ``multilink`` part, as plain data, is turned into kinetic energy
T, potential V and a dissipation function R of world coordinates ``q = (x, y, psi, joint angles)``; the
equations are

    d/dt dT/dq' - dT/dq + dV/dq + dR/dq' = Q

with every derivative taken by automatic differentiation, so that no velocity recursion, no Munk
moment, no composite inertia and no torque law is ever written down. Only lift, which neither stores
nor loses energy, momentum shed at trailing edges and forces fixed to a link enter as generalised
forces Q. An adaptive Runge-Kutta method of eighth order integrates them.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

with contextlib.suppress(ImportError):  # tests that need CasADi are skipped without it
    import casadi as ca


class Lagrange:
    """Equations of motion of a tree.

    Parameters
    ----------
    body : mapping
        The ``multilink`` part of a robot file. Drag elements must be points.
    density, gravity : float
    values : mapping of coefficient to float, optional
        Default the file's own.
    """

    def __init__(
        self,
        body: Mapping[str, Any],
        *,
        density: float = 1000.0,
        gravity: float = 9.81,
        values: Mapping[str, float] | None = None,
    ) -> None:
        own = {name: c["value"] for name, c in body.get("coefficients", {}).items()}
        self.values = {**own, **(values or {})}
        self.body, self.density, self.gravity = body, density, gravity
        joints = body.get("joints", [])
        self.passive = [j for j in joints if j.get("passive") is not None]
        self.driven = [j for j in joints if j.get("driven") is not None]
        self.free = 3 + len(self.passive)
        size = self.free + len(self.driven)
        q, qd = ca.SX.sym("q", size), ca.SX.sym("qd", size)
        self._q, self._qd = q, qd
        self._angle = {j["name"]: 3 + k for k, j in enumerate([*self.passive, *self.driven])}
        self._pose = self._poses()
        kinetic, potential = self._kinetic(), self._potential()
        momentum = ca.gradient(kinetic, qd)
        mass = ca.jacobian(momentum, qd)
        rest = (
            ca.jtimes(momentum, q, qd)
            - ca.gradient(kinetic - potential, q)
            + ca.gradient(self._dissipation(), qd)
            - self._forces()
        )
        told = ca.SX.sym("told", len(self.driven))
        first = 0 if body.get("base", "free") == "free" else 3
        f = slice(first, self.free)
        right = -(rest[f] + ca.mtimes(mass[f, self.free :], told))
        found = ca.vertcat(ca.SX.zeros(first), ca.solve(mass[f, f], right))
        self._acceleration = ca.Function("acceleration", [q, qd, told], [found])
        self._conserved = ca.Function("conserved", [q, qd], [kinetic + potential, momentum])
        self._found, self._told = found, told
        every = ca.SX.sym("every", size)
        self._torque = ca.Function("torque", [q, qd, every], [(ca.mtimes(mass, every) + rest)[self.free :]])

    # ---------------------------------------------------------------- geometry

    def number(self, quantity: Any) -> float:
        """A quantity's value."""
        if quantity is None:
            return 0.0
        words = [word.strip() for word in str(quantity).split("*")]
        return math.prod(float(self.values.get(word, word)) for word in words)

    def _poses(self) -> dict[str, tuple[Any, Any]]:
        q = self._q
        first = self.body["links"][0]["name"]
        lengths = {link["name"]: link["length_m"] for link in self.body["links"]}
        pose = {first: (q[:2], q[2])}
        left = list(self.body.get("joints", []))
        while left:
            ready = [j for j in left if j["parent"] in pose]
            for j in ready:
                _, psi = pose[j["parent"]]
                at = lengths[j["parent"]] if j.get("at_m") is None else self.number(j["at_m"])
                place = self._point(pose, j["parent"], at, self.number(j.get("offset_m", 0)))
                turn = math.radians(j.get("mount_deg", 0.0))
                angle = q[self._angle[j["name"]]] if j["name"] in self._angle else 0.0
                pose[j["child"]] = (place, psi + turn + angle)
            left = [j for j in left if j not in ready]
        return pose

    @staticmethod
    def _point(pose: dict[str, tuple[Any, Any]], link: str, station: float, offset: float) -> Any:
        origin, psi = pose[link]
        ahead, port = ca.vertcat(ca.cos(psi), ca.sin(psi)), ca.vertcat(-ca.sin(psi), ca.cos(psi))
        return origin - station * ahead + offset * port

    def _at(self, link: str, station: Any, offset: Any = 0.0) -> Any:
        return self._point(self._pose, link, self.number(station), self.number(offset))

    def _speed(self, place: Any) -> Any:
        return ca.jtimes(place, self._q, self._qd)

    def _split(self, link: str, vector: Any) -> tuple[Any, Any]:
        psi = self._pose[link][1]
        c, s = ca.cos(psi), ca.sin(psi)
        return c * vector[0] + s * vector[1], c * vector[1] - s * vector[0]

    def _spin(self, link: str) -> Any:
        return ca.jtimes(self._pose[link][1], self._q, self._qd)

    # ---------------------------------------------------------------- energies

    def _elements(self, kind: str) -> list[Mapping[str, Any]]:
        return [e for e in self.body.get("elements", []) if e["kind"] == kind]

    def _link(self, name: str) -> Mapping[str, Any]:
        return next(link for link in self.body["links"] if link["name"] == name)

    def _centre(self, link: Mapping[str, Any]) -> Any:
        return self._at(link["name"], link["com_m"], link.get("com_offset_m", 0.0))

    def _kinetic(self) -> Any:
        total = ca.SX(0)
        for link in self.body["links"]:
            m, moment = self.number(link["mass_kg"]), self.number(link["inertia_kg_m2"])
            if link["inertia_about"] == "front":
                moment -= m * (
                    self.number(link["com_m"]) ** 2 + self.number(link.get("com_offset_m", 0)) ** 2
                )
            total += 0.5 * m * ca.sumsqr(self._speed(self._centre(link)))
            total += 0.5 * moment * self._spin(link["name"]) ** 2
        for e in self._elements("added-mass"):
            station = e["at_m"] if e.get("at_m") is not None else self._link(e["link"])["com_m"]
            along, across = self._split(
                e["link"], self._speed(self._at(e["link"], station, e.get("offset_m", 0)))
            )
            total += 0.5 * self.number(e.get("surge_kg", 0)) * along**2
            total += 0.5 * self.number(e.get("sway_kg", 0)) * across**2
            total += 0.5 * self.number(e.get("inertia_kg_m2", 0)) * self._spin(e["link"]) ** 2
        return total

    def _potential(self) -> Any:
        total = ca.SX(0)
        for joint in self.passive:
            law, angle = joint["passive"], self._q[self._angle[joint["name"]]]
            off = angle - math.radians(law.get("rest_deg", 0.0))
            total += 0.5 * self.number(law.get("stiffness_N_m_rad", 0)) * off**2
            total += 0.25 * self.number(law.get("cubic_N_m_rad3", 0)) * off**4
            if law.get("tendon"):
                wire = {key: self.number(value) for key, value in law["tendon"].items()}
                arm, crank = wire["arm_m"], wire["crank_m"]
                # Eqs 3 and 4: the wire runs from the crank's tip to the arm's root
                tip = ca.vertcat(crank * ca.cos(angle), crank * ca.sin(angle))
                stretch = ca.norm_2(tip - ca.vertcat(arm, 0.0)) - (arm - crank)
                total += 0.5 * wire["spring_N_m"] * (wire["pretension_m"] + stretch) ** 2
        for e in self._elements("hydrostatics"):
            link = self._link(e["link"])
            total += self.number(link["mass_kg"]) * self.gravity * self._centre(link)[1]
            station = e["buoyancy_at_m"] if e.get("buoyancy_at_m") is not None else link["com_m"]
            lift = self.density * self.gravity * self.number(e.get("volume_m3", 0))
            total -= lift * self._at(e["link"], station, e.get("buoyancy_offset_m", 0))[1]
        for e in self._elements("force"):
            if e.get("frame", "link") == "world":
                push = ca.vertcat(self.number(e.get("forward_N", 0)), self.number(e.get("port_N", 0)))
                total -= ca.dot(push, self._at(e["link"], e.get("at_m", 0), e.get("offset_m", 0)))
        return total

    def _dissipation(self) -> Any:
        def lost(speed: Any, quadratic: float, linear: float) -> Any:
            return quadratic * ca.fabs(speed) ** 3 / 3.0 + 0.5 * linear * speed**2

        total = ca.SX(0)
        for e in self._elements("drag"):
            assert e.get("strips", 3) == 1
            station = e["at_m"] if e.get("at_m") is not None else 0.5 * self._link(e["link"])["length_m"]
            speeds = self._split(e["link"], self._speed(self._at(e["link"], station, e.get("offset_m", 0))))
            for axis, speed in zip(("axial", "normal"), speeds, strict=True):
                area, c = (self.number(e.get(f"{axis}_{what}", 0)) for what in ("area_m2", "coefficient"))
                total += lost(
                    speed, 0.5 * self.density * area * c, self.number(e.get(f"{axis}_linear_N_s_m", 0))
                )
        for e in self._elements("damping"):
            gains = (self.number(e.get(k, 0)) for k in ("quadratic_N_m_s2_rad2", "linear_N_m_s_rad"))
            total += lost(self._spin(e["link"]), *gains)
        for joint in self.passive:
            law = joint["passive"]
            gains = (
                self.number(law.get(k, 0)) for k in ("quadratic_damping_N_m_s2_rad2", "damping_N_m_s_rad")
            )
            rate = self._qd[self._angle[joint["name"]]]
            total += lost(rate, *gains)
            # the slope of this is dry friction, rounded off
            dry, below = self.number(law.get("friction_N_m", 0)), law.get("friction_below_rad_s", 0.02)
            total += dry * ca.sqrt(rate**2 + below**2)
        return total

    def _forces(self) -> Any:
        total = ca.SX.zeros(self._q.numel())

        def push(place: Any, force: Any) -> None:
            nonlocal total
            total += ca.mtimes(ca.jacobian(place, self._q).T, force)

        for e in self._elements("foil"):
            place = self._at(e["link"], e["at_m"], e.get("offset_m", 0))
            velocity = self._speed(place)
            course = ca.atan2(velocity[1], velocity[0])
            attack = course - self._pose[e["link"]][1] - math.radians(e.get("chord_deg", 0.0))
            lift = self.number(e["lift_coefficient"]) * ca.sin(2 * attack)
            cd0, cd1 = (self.number(e.get(f"drag_coefficient_{k}", 0)) for k in (0, 1))
            loss = cd0 + cd1 * (1 - ca.cos(2 * attack))
            pressure = 0.5 * self.density * self.number(e["area_m2"]) * ca.sumsqr(velocity)
            right = course - math.pi / 2
            push(place, pressure * lift * ca.vertcat(ca.cos(right), ca.sin(right)))
            push(place, -pressure * loss * ca.vertcat(ca.cos(course), ca.sin(course)))
        for e in self._elements("trailing-edge"):
            # Lighthill's own form: the shed momentum m w turned by a right angle to the velocity, less
            # the pressure m w^2 / 2 along the link; backwards only the latter's opposite is left
            station = e["at_m"] if e.get("at_m") is not None else self._link(e["link"])["length_m"]
            place = self._at(e["link"], station, e.get("offset_m", 0))
            velocity, psi = self._speed(place), self._pose[e["link"]][1]
            ahead, across = self._split(e["link"], velocity)
            m, axis = self.number(e["added_mass_kg_m"]), ca.vertcat(ca.cos(psi), ca.sin(psi))
            shed = m * across * ca.vertcat(velocity[1], -velocity[0])
            pressure = 0.5 * m * across**2 * axis
            push(place, ca.if_else(ahead > 0, shed - pressure, pressure))
        for e in self._elements("force"):
            if e.get("frame", "link") == "link":
                psi = self._pose[e["link"]][1]
                a, b = self.number(e.get("forward_N", 0)), self.number(e.get("port_N", 0))
                force = ca.vertcat(a * ca.cos(psi) - b * ca.sin(psi), a * ca.sin(psi) + b * ca.cos(psi))
                push(self._at(e["link"], e.get("at_m", 0), e.get("offset_m", 0)), force)
        return total

    # ---------------------------------------------------------------- what is asked of it

    def acceleration(self, q: Any, qd: Any, told: Any) -> np.ndarray:
        """Accelerations of the free coordinates.

        Parameters
        ----------
        q, qd : arrays, shape (free + driven,)
            World pose of the base, passive angles, driven angles; and their rates.
        told : array, shape (driven,)
            Accelerations of the driven joints.
        """
        return np.asarray(self._acceleration(q, qd, told)).ravel()

    def torque(self, q: Any, qd: Any, qdd: Any) -> np.ndarray:
        """Generalised forces of the driven joints, all accelerations told."""
        return np.asarray(self._torque(q, qd, qdd)).ravel()

    def conserved(self, q: Any, qd: Any) -> tuple[float, np.ndarray]:
        """Energy T + V, and the impulse: two components in the world and the moment about its origin."""
        energy, momentum = self._conserved(q, qd)
        p = np.asarray(momentum).ravel()
        return float(energy), np.array([p[0], p[1], p[2] + q[0] * p[1] - q[1] * p[0]])

    def swim(
        self,
        beat: Callable[[Any], Any],
        times: np.ndarray,
        *,
        breaks: tuple[float, ...] = (),
        start: np.ndarray | None = None,
        rtol: float = 1e-11,
    ) -> np.ndarray:
        """States at the given times, from rest at the world's origin unless told otherwise.

        Parameters
        ----------
        beat : callable
            CasADi expression of the common command at time t; each driven joint takes its gain of it.
        times : ndarray, shape (m,)
            From the start on.
        breaks : tuple of float
            Times at which the command is not smooth.

        Returns
        -------
        ndarray, shape (m, 2 free)
            Pose and passive angles, then velocity in the base's own axes and passive rates.
        """
        t, state = ca.SX.sym("t"), ca.SX.sym("state", 2 * self.free)
        gains = ca.DM([j["driven"].get("gain", 1.0) for j in self.driven])
        angle = beat(t) * gains
        rate = ca.jacobian(angle, t)
        told = ca.jacobian(rate, t)
        q, qd = ca.vertcat(state[: self.free], angle), ca.vertcat(state[self.free :], rate)
        found = ca.substitute(self._found, ca.vertcat(self._q, self._qd, self._told), ca.vertcat(q, qd, told))
        compiled = ca.Function("rate", [t, state], [ca.vertcat(state[self.free :], found)])
        buffer, call = compiled.buffer()
        moment, here, answer = np.zeros(1), np.zeros(2 * self.free), np.zeros(2 * self.free)
        buffer.set_arg(0, memoryview(moment))
        buffer.set_arg(1, memoryview(here))
        buffer.set_res(0, memoryview(answer))

        def right(time: float, point: np.ndarray) -> np.ndarray:
            moment[0], here[:] = time, point
            call()
            return answer.copy()

        now = np.zeros(2 * self.free) if start is None else start
        ends = [float(times[0]), *(b for b in breaks if times[0] < b < times[-1]), float(times[-1])]
        pieces = []
        for low, high in pairwise(ends):
            asked = times[(times >= low) & (times < high)]
            run = solve_ivp(right, (low, high), now, "DOP853", [*asked, high], rtol=rtol, atol=1e-13)
            pieces.append(run.y[:, : len(asked)].T)
            now = run.y[:, -1]
        states = np.vstack([*pieces, now])
        c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
        u, v = states[:, self.free].copy(), states[:, self.free + 1].copy()
        states[:, self.free], states[:, self.free + 1] = c * u + s * v, c * v - s * u
        return states


def sine(frequency: float, amplitude: float, ramp: float) -> Callable[[Any], Any]:
    """A sine eased in over ``ramp`` by the polynomial whose first two derivatives vanish at both ends."""

    def beat(t: Any) -> Any:
        s = t / ramp
        ease = ca.if_else(t < ramp, 10 * s**3 - 15 * s**4 + 6 * s**5, 1.0)
        return amplitude * ease * ca.sin(2 * math.pi * frequency * t)

    return beat


def random_tree(rng: np.random.Generator, links: int, passive: int, *, fluid: bool = True) -> dict[str, Any]:
    """A random branching tree with offsets, mounting angles, springs, tendons and every kind of element.

    Parameters
    ----------
    rng : numpy Generator
    links : int
    passive : int
        How many joints, chosen at random, yield; about one in four of the others is rigid.
    fluid : bool
        Without it: rigid bodies, springs and dampers only.
    """

    def some(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    more = rng.spawn(1)[0]

    def other(low: float, high: float) -> float:
        return float(more.uniform(low, high))

    names = [f"link{i}" for i in range(links)]
    bodies, joints, elements = [], [], []
    for i, name in enumerate(names):
        length, mass = some(0.05, 0.4), some(0.1, 2.0)
        com, side = some(0.2, 0.8) * length, some(-0.1, 0.1) * length
        about = ("front", "com")[int(rng.integers(2))]
        moment = some(0.05, 0.3) * mass * length**2
        if about == "front":
            moment += mass * (com**2 + side**2)
        bodies.append(
            {"name": name, "length_m": length, "mass_kg": mass, "com_m": com, "com_offset_m": side,
             "inertia_kg_m2": moment, "inertia_about": about}
        )  # fmt: skip
        if i:
            joint: dict[str, Any] = {
                "name": f"joint{i}", "parent": names[int(rng.integers(max(0, i - 2), i))], "child": name,
                "mount_deg": some(-60, 60), "offset_m": some(-0.03, 0.03),
            }  # fmt: skip
            if rng.random() < 0.5:
                joint["at_m"] = some(0.0, 0.3)
            joints.append(joint)
    yielding = set(rng.permutation(links - 1)[:passive].tolist())
    for k, joint in enumerate(joints):
        if k in yielding:
            joint["passive"] = {
                "stiffness_N_m_rad": some(0.1, 2), "cubic_N_m_rad3": some(0, 3), "rest_deg": some(-20, 20),
                "damping_N_m_s_rad": some(0, 0.05), "quadratic_damping_N_m_s2_rad2": some(0, 0.05),
                "friction_N_m": other(0, 0.1), "friction_below_rad_s": other(0.01, 1.0),
                "tendon": {
                    "spring_N_m": some(10, 90), "pretension_m": some(0, 0.04), "arm_m": 0.03, "crank_m": 0.02,
                },
            }  # fmt: skip
        elif rng.random() < 0.75:
            joint["driven"] = {"gain": some(-1, 1)}
    for name in names if fluid else ():
        length = bodies[names.index(name)]["length_m"]
        elements += [
            {
                "kind": "added-mass", "link": name, "surge_kg": some(0, 0.5), "sway_kg": some(0.2, 3),
                "inertia_kg_m2": some(0, 0.01), "at_m": some(0, length), "offset_m": some(-0.05, 0.05),
            },
            {
                "kind": "drag", "link": name, "strips": 1, "at_m": some(0, length),
                "offset_m": some(-0.02, 0.02),
                "axial_area_m2": some(0, 0.01), "axial_coefficient": some(0, 0.5),
                "normal_area_m2": some(0, 0.02), "normal_coefficient": some(0, 4),
                "axial_linear_N_s_m": some(0, 0.2), "normal_linear_N_s_m": some(0, 0.5),
            },
            {
                "kind": "damping", "link": name, "linear_N_m_s_rad": some(0, 0.01),
                "quadratic_N_m_s2_rad2": some(0, 0.02),
            },
            {
                "kind": "foil", "link": name, "area_m2": some(0.001, 0.01), "at_m": some(0, length),
                "offset_m": some(-0.02, 0.02), "chord_deg": some(-90, 90), "lift_coefficient": some(0.5, 3),
                "drag_coefficient_0": some(0, 0.1), "drag_coefficient_1": some(0, 1.2),
            },
            {
                "kind": "trailing-edge", "link": name, "added_mass_kg_m": other(0, 5),
                "offset_m": other(-0.02, 0.02), **({"at_m": other(0, length)} if other(0, 1) < 0.5 else {}),
            },
            {
                "kind": "hydrostatics", "link": name, "volume_m3": some(0, 0.002),
                "buoyancy_at_m": some(0, length), "buoyancy_offset_m": some(-0.02, 0.02),
            },
            {
                "kind": "force", "link": name, "at_m": some(0, length), "offset_m": some(-0.02, 0.02),
                "forward_N": some(-1, 1), "port_N": some(-1, 1),
                "frame": ("link", "world")[int(rng.integers(2))],
            },
        ]  # fmt: skip
    return {"plane": "vertical", "links": bodies, "joints": joints, "elements": elements}
