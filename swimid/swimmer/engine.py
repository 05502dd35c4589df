"""Functions and columns that the equations of motion in a plane and in 3-D share.

An engine is the compiled equations of motion of a tree of rigid links in water, with their time integration.
Its input arrays (tables) hold the inertias, joints and hydrodynamic elements of the links. The functions do
not check indices, because :mod:`swimid.swimmer.tree` has checked them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.files.kernels import numba
from swimid.fitting.model import MOST_FORCES, ExternalForce, no_force
from swimid.robots.elements import MAX_FACTORS

#: Magnitude of an entry of the state vector from which a simulation has diverged.
MAX_STATE = 1e6
PASSIVE = (
    "stiffness",
    "cubic",
    "damping",
    "quadratic_damping",
    "rest",
    "spring",
    "pretension",
    "arm",
    "crank",
    "friction",
    "friction_below",
)
#: Entries of the input arrays that effects may change although they are zero in the robot file.
FILLED: dict[str, Any] = {"passive": slice(0, PASSIVE.index("rest") + 1), "load": -1}
#: Number of integers for an element in the input array ``ELEMENT_link``: its link; for a propeller also the
#: row of its input; for a rudder also the rows of its input and of its propeller; for a term also its
#: component and the indices of its velocities.
INTEGERS = {"propeller": 2, "rudder": 3, "term": 2 + MAX_FACTORS, "slider": 2}
#: Speed below which the quotient of velocities and speed in a term falls to zero, m/s.
LEAST_SPEED = 1e-9

#: Columns of the input arrays ``joint`` and ``inertia`` in 3-D: position of a hinge on the parent, direction
#: of its axis in the child, and the matrices of the rotation ``M0 + sin M1 + (1 - cos) M2`` from child to
#: parent, row by row; blocks A, B and D of the apparent inertia matrix of a link.
LINK_COLUMNS = {
    "joint": (
        *(f"at_{c}" for c in "xyz"),
        *(f"axis_{c}" for c in "xyz"),
        *(f"turn{m}_{r}{c}" for m in range(3) for r in range(3) for c in range(3)),
    ),
    "inertia": (
        *(f"A{p}" for p in ("00", "01", "02", "11", "12", "22")),
        *(f"B{r}{c}" for r in range(3) for c in range(3)),
        *(f"D{p}" for p in ("00", "01", "02", "11", "12", "22")),
    ),
}
#: Columns of the input arrays of elements in 3-D. An array in a plane has some of them. Each row begins with
#: a point of its link. ``size`` is half the range of height in which a point leaves the water; 0 if the point
#: always counts as under water. ``world`` is 1 if a force has the axes of the world.
#:
#: ``load`` has force and moment for an input of 1, and the decrease ``loss`` of the input's effect per square
#: root of the input and per velocity along the force (:func:`reduce_input`). ``propeller`` has point and
#: axis, the coefficients of :func:`thrust_of`, and the factors on the thrust (1 - t) and on the velocity of
#: advance (1 - w). With the thrust T, the slipstream far behind the propeller has the square of the velocity
#: ``u_a^2 + jet T``. ``rudder`` has the points of the force on the rudder, of the force on the hull and of
#: the inflow, the direction across the hull in which the rudder pushes at a negative angle, and the
#: coefficients of :func:`rudder_force`. ``slider`` has the place of a moving mass for an input of 0, its
#: displacement for an input of 1, its mass, and its weight if it acts.
ELEMENT_COLUMNS: dict[str, tuple[str, ...]] = {
    "drag": (*"xyz", *(f"quadratic_{c}" for c in "xyz"), *(f"linear_{c}" for c in "xyz"), "size"),
    "damping": ("quadratic_p", "quadratic_q", "quadratic_r", "linear_p", "linear_q", "linear_r"),
    "foil": (
        *(*"xyz", "half_rho_area", "cl", "cd0", "cd1"),
        *(f"{direction}_{c}" for direction in ("chord", "normal") for c in "xyz"),
        "size",
    ),
    "force": (*"xyz", *(f"force_{c}" for c in "xyz"), "world", "size"),
    "wake": (*"xyz", "half_mass"),
    "load": (*"xyz", *(f"force_{c}" for c in "xyz"), *(f"moment_{c}" for c in "xyz"), "world", "loss"),
    "propeller": (
        *(*"xyz", *(f"axis_{c}" for c in "xyz"), "static", "slope", "curve", "share", "wake", "jet"),
        *("wake_decay", "wake_port", "wake_starboard"),
    ),
    "rudder": (
        *(*"xyz", *(f"{point}_{c}" for point in ("hull", "inflow", "side") for c in "xyz")),
        *("lift", "drag_share", "hull_share", "straightening_port", "straightening_starboard", "ratio"),
        *("gain", "covered"),
    ),
    "term": (*"xyz", "coefficient"),
    "slider": (*"xyz", *(f"travel_{c}" for c in "xyz"), "mass", "weight"),
}


@dataclass(frozen=True)
class Engine:
    """Compiled equations of motion, in a plane or in 3-D.

    The functions take the input arrays of a robot as one tuple, in the order of :attr:`columns`. The array of
    an element follows the array ``ELEMENT_link`` of its integers. The row of each load's input and the
    constants of the engine come last.

    Attributes
    ----------
    columns : mapping of str to tuple of str
        Columns of each input array.
    coordinates, speeds : int
        Numbers of coordinates and of velocities of the base in a state vector. The passive joint angles
        follow the coordinates, and the passive joint rates follow the velocities.
    work : int
        Number of columns of the work array, which has one row for each link.
    velocities, components : mapping of str to int
        Indices of the velocities and of the components of hydrodynamic derivatives.
    compute_rate : function ``(state, row, tables, forced, time, work, matrix, right, rate)``
        Writes the time derivative of the state into ``rate``. ``row`` has angle, rate, acceleration, cosine
        and sine of each driven joint, and the value of each input in the first column, shape (driven joints +
        inputs, 5). ``forced`` are the forces of effects (:func:`pack_forces`), or None. ``work``, ``matrix``
        and ``right`` are scratch arrays (:meth:`shapes`).
    integrate : function ``(start, step, table, tables, forced, begin)``
        Returns the states and their rates at every step, shape (steps + 1, k), by a fourth-order Runge-Kutta
        method with fixed steps. They are NaN from the step at which the simulation diverges. ``table`` has
        the rows of the driven joints on the half-step grid, and ``begin`` is the time of the first state.
    compute_torques : function ``(states, rates, table, tables, forced, begin, step)``
        Returns by inverse dynamics the moment that its parent exerts on each link, shape (m, links), and the
        wrench that holds the base, at the origin and in the axes of the base. They are zero for a free base.
    correct_state : function ``(state)``
        Corrects the state after an integration step, in place.
    """

    columns: Mapping[str, tuple[str, ...]]
    coordinates: int
    speeds: int
    work: int
    velocities: Mapping[str, int]
    components: Mapping[str, int]
    compute_rate: Callable[..., None]
    integrate: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]]
    compute_torques: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]]
    correct_state: Callable[..., None]

    def shapes(self, tables: Mapping[str, Any]) -> tuple[int, list[tuple[int, ...]]]:
        """Return the length of the state vector, and the shapes of the scratch arrays."""
        n = self.speeds + len(tables["passive"])
        size = n + self.coordinates + len(tables["passive"])
        return size, [(len(tables["topology"]), self.work), (n, n), (n,)]


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def positive(asked, then, otherwise):  # type: ignore[no-untyped-def]
    """Return ``then`` if ``asked`` is above 0, and ``otherwise`` if it is not, or if it is NaN.

    Both values are computed by the caller, whichever is returned.

    >>> positive(1.0, 2.0, 3.0)
    2.0
    """
    return then if asked > 0.0 else otherwise


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def find_heading(frame, base, turn):  # type: ignore[no-untyped-def]
    """Return the heading of a link in the world, rad.

    The heading is continuous when the base turns by more than half a rotation.

    Parameters
    ----------
    frame : (heading in rad, its cosine, its sine)
        Direction of the simulation's axes in the world.
    base : (heading in rad, its cosine, its sine)
        Direction of the base in the simulation's axes.
    turn : (cosine, sine)
        Direction of the link in the simulation's axes.
    """
    across = turn[1] * base[1] - turn[0] * base[2]
    return frame[0] + base[0] + math.atan2(across, turn[0] * base[1] + turn[1] * base[2])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def tendon_torque(angle, spring, pretension, arm, crank):  # type: ignore[no-untyped-def]
    """Return the torque of a wire and spring that pull a joint straight, N m.

    Parameters
    ----------
    angle : float, rad
    spring : float, N/m
        K_t.
    pretension : float, m
        d_p, elongation at zero angle.
    arm, crank : float, m
        l_3 and l_ps; the crank must be the shorter.

    Returns
    -------
    float
        Torque ``-dE/dphi`` of Eqs 3 and 4 in the paper on the built-in robot ``tfish``.

    Notes
    -----
    With ``D = sqrt(l_3^2 + l_ps^2 - 2 l_3 l_ps cos phi)`` and ``d_t = D - l_3 + l_ps`` it is
    ``-K_t (d_p + d_t) l_3 l_ps sin(phi) / D``. Eq 11 of the paper is the same if its misprinted argument is
    read as ``arccos((l_3 - l_cr cos phi) / D)``.
    """
    distance = math.sqrt(arm * arm + crank * crank - 2.0 * arm * crank * math.cos(angle))
    stretch = distance - arm + crank
    return -spring * (pretension + stretch) * arm * crank * math.sin(angle) / distance


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def passive_torque(passive, k, angle, w):  # type: ignore[no-untyped-def]
    """Return the torque (N m) of passive joint ``k`` at an angle (rad) and a rate (rad/s).

    ``passive`` is the input array with the columns :data:`PASSIVE`.
    """
    off = angle - passive[k, 4]
    torque = -(passive[k, 0] + passive[k, 1] * off * off) * off
    torque -= (passive[k, 2] + passive[k, 3] * abs(w)) * w
    if passive[k, 9] != 0.0:
        torque -= passive[k, 9] * w / math.sqrt(w * w + passive[k, 10] * passive[k, 10])
    if passive[k, 5] != 0.0:
        torque += tendon_torque(angle, passive[k, 5], passive[k, 6], passive[k, 7], passive[k, 8])
    return torque


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def reduce_input(size, loss, along):  # type: ignore[no-untyped-def]
    """Return the input of a load whose force falls with the velocity along the force.

    A propeller at the rate n has the thrust ``T = a n |n| - b |n| u`` with the velocity u along T. Its thrust
    at rest ``T_0 = a n |n|`` gives ``T = T_0 - c sqrt(|T_0|) u``.

    Parameters
    ----------
    size : float
        Input, by which the thrust at rest is proportional.
    loss : float
        ``c / g^1.5`` with the force g for an input of 1, N.
    along : float
        Scalar product of the velocity of the point of action and the force for an input of 1.
    """
    return size - loss * math.sqrt(abs(size)) * along


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def thrust_of(n, advance, static, slope, curve):  # type: ignore[no-untyped-def]
    """Return the thrust of a propeller, N, at a rate n (1/s) and a velocity of advance u (m/s).

    The thrust is ``static n |n| + slope |n| u + curve sign(n) u^2``. With K_T = k_0 + k_1 J + k_2 J^2 and J =
    u / (n D), the coefficients are ``rho D^4 k_0``, ``rho D^3 k_1`` and ``rho D^2 k_2``. A propeller that
    turns backwards has the thrust of its mirror image, ``T(-n, -u) = -T(n, u)``.
    """
    side = positive(n, 1.0, positive(-n, -1.0, 0.0))
    return static * n * abs(n) + slope * abs(n) * advance + curve * side * advance * advance


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def inflow_speed(advance, thrust, jet, ratio, gain, covered):  # type: ignore[no-untyped-def]
    """Return the velocity of the water at a rudder along the hull, m/s (Yasukawa and Yoshimura 2015, Eq 24).

    The share ``covered`` of the rudder's height lies in the slipstream. There, the velocity has grown by the
    share ``gain`` of its growth far behind the propeller. In the printed equation the growth far behind is
    ``u_P (sqrt(1 + 8 K_T / (pi J^2)) - 1)``. This module writes it with the thrust, without a division by J.
    """
    far = math.sqrt(max(advance * advance + jet * thrust, 0.0))
    within = advance + gain * (far - abs(advance))
    size = math.sqrt(covered * within * within + (1.0 - covered) * advance * advance)
    return ratio * positive(covered * within + (1.0 - covered) * advance, size, -size)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def rudder_force(along, aside, lift, port, starboard, sine, cosine):  # type: ignore[no-untyped-def]
    """Return the normal force on a rudder, N (Yasukawa and Yoshimura 2015, Eqs 21 to 23).

    ``F_N = rho / 2 A_R f_a U_R^2 sin(alpha_R)`` with the inflow velocity U_R and its angle to the rudder.

    Parameters
    ----------
    along : float, m/s
        Velocity of the water along the hull (:func:`inflow_speed`).
    aside : float, m/s
        Velocity of the hull to port, at the point of the inflow. The water has the opposite velocity,
        multiplied by the flow straightening coefficient of this side.
    lift : float
        ``rho / 2 A_R f_a``.
    port, starboard : float
        Flow straightening coefficients for motion to port and to starboard.
    sine, cosine : float
        Sine and cosine of the rudder angle.
    """
    across = aside * positive(aside, port, starboard)
    return lift * math.sqrt(along * along + across * across) * (along * sine + across * cosine)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def wake_growth(aside, speed, decay, port, starboard):  # type: ignore[no-untyped-def]
    """Return the factor of 1 - w of a propeller in oblique motion (Yasukawa and Yoshimura 2015, Eq 18).

    The factor multiplies 1 - w, with the wake fraction w. Its value is
    ``1 + (1 - exp(-C_1 |b_P|)) (C_2 - 1)``, with the sine of the drift angle of the propeller for b_P.

    Parameters
    ----------
    aside, speed : float, m/s
        Velocity of the propeller to port, and its speed.
    decay : float
        C_1.
    port, starboard : float
        C_2 - 1 for motion to port and to starboard.
    """
    angle = abs(aside) / max(speed, LEAST_SPEED)
    return 1.0 + (1.0 - math.exp(-decay * angle)) * positive(aside, port, starboard)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def product_of(coefficient, integers, velocities):  # type: ignore[no-untyped-def]
    """Return the product of a coefficient and the velocities of a term.

    Parameters
    ----------
    coefficient : float
    integers : ndarray of int
        Row of ``term_link``.
    velocities : tuple of float
        Velocities in the order of their indices.
    """
    for m in range(2, len(integers)):
        coefficient = coefficient * velocities[integers[m]]
    return coefficient


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def solve_accelerations(matrix, right, first):  # type: ignore[no-untyped-def]
    """Solve the equations of motion from row ``first`` on for the accelerations.

    The LDL^T factorisation overwrites the lower triangle of the matrix. The solution overwrites ``right``.
    """
    n = len(right)
    for j in range(first, n):
        pivot = matrix[j, j]
        for m in range(first, j):
            pivot -= matrix[j, m] * matrix[j, m] * matrix[m, m]
        matrix[j, j] = positive(pivot, pivot, math.nan)
        for i in range(j + 1, n):
            entry = matrix[i, j]
            for m in range(first, j):
                entry -= matrix[i, m] * matrix[j, m] * matrix[m, m]
            matrix[i, j] = entry / pivot
    for i in range(first, n):
        for m in range(first, i):
            right[i] -= matrix[i, m] * right[m]
    for i in range(n - 1, first - 1, -1):
        right[i] /= matrix[i, i]
        for m in range(i + 1, n):
            right[i] -= matrix[m, i] * right[m]


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def has_diverged(state, rate):  # type: ignore[no-untyped-def]
    """Return whether a simulation has diverged: a state is too large, or its rate is not finite."""
    largest = 0.0
    for j in range(len(state)):
        largest = max(largest, abs(state[j]))
        if not abs(rate[j]) < math.inf:
            largest = math.inf
    return not largest < MAX_STATE


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def begin_stage(stage, step, here, slope, total, trial):  # type: ignore[no-untyped-def]
    """Write the state of a stage of the Runge-Kutta method to ``trial``, and add the last slope to ``total``.

    The stages are 0 to 4. The state of stage 4 is the state after the step.
    """
    for j in range(len(here)):
        if stage == 0:
            trial[j] = here[j]
            total[j] = 0.0
        elif stage < 3:
            total[j] += stage * slope[j]
            trial[j] = here[j] + 0.5 * step * slope[j]
        elif stage == 3:
            total[j] += 2.0 * slope[j]
            trial[j] = here[j] + step * slope[j]
        else:
            trial[j] = here[j] + step / 6.0 * (total[j] + slope[j])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def interpolate_states(time, begin, step, states, rates):  # type: ignore[no-untyped-def]
    """Return the states of a simulation at given times, by cubic Hermite interpolation.

    Parameters
    ----------
    time : ndarray, shape (m,), s
        Times before the first step give the first state, times after the last step the last state.
    begin, step : float, s
        Time of the first state and step of the grid.
    states, rates : ndarray, shape (steps + 1, k)

    Returns
    -------
    ndarray, shape (m, k)
        The error is of fourth order in the step, as that of the integration.
    """
    count, size = len(time), states.shape[1]
    values = np.empty((count, size))
    last = states.shape[0] - 1
    for i in range(count):
        place = min(max((time[i] - begin) / step, 0.0), float(last))
        k = min(int(place), max(last - 1, 0))
        f = place - k
        # at a time on the grid, up to rounding, return the state of the grid
        if abs(f) < 1e-9 or abs(f - 1.0) < 1e-9 or last == 0:
            k = min(k + int(f + 0.5), last)
            for j in range(size):
                values[i, j] = states[k, j]
            continue
        h00, h10 = (1.0 + 2.0 * f) * (1.0 - f) ** 2, f * (1.0 - f) ** 2
        h01, h11 = f * f * (3.0 - 2.0 * f), f * f * (f - 1.0)
        for j in range(size):
            a, b = states[k, j], states[k + 1, j]
            da, db = step * rates[k, j], step * rates[k + 1, j]
            values[i, j] = h00 * a + h10 * da + h01 * b + h11 * db
    return values


def place_frame(
    pose: Sequence[float], reference: Sequence[float] | NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the coordinate frame of a simulation in the world, for the forces of effects, shape (8,).

    Parameters
    ----------
    pose : (x, y, heading), m and rad
        Origin and direction of the simulation's axes in the world.
    reference : (x, y) or (x, y, z), m
        Reference point in the base's axes. The forces depend on its position.
    """
    x, y, heading = pose
    height = reference[2] if len(reference) > 2 else 0.0
    return np.array([x, y, math.cos(heading), math.sin(heading), *reference[:2], heading, height])


def pack_forces(forces: Sequence[ExternalForce], frame: NDArray[np.float64], links: int) -> tuple[Any, ...]:
    """Return the forces of effects in the form of the argument ``forced`` of :func:`integrate`.

    Parameters
    ----------
    forces : sequence of ExternalForce, at most :data:`swimid.fitting.model.MOST_FORCES`
    frame : ndarray, shape (8,)
        Result of :func:`place_frame`.
    links : int
        Number of links.
    """
    functions = [f.function for f in forces] + [no_force] * (MOST_FORCES - len(forces))
    ends = np.concatenate(([0], np.cumsum([len(f.constants) for f in forces]))).astype(np.int64)
    return (
        np.array([f.link % links for f in forces], dtype=np.int64),
        np.array([(f.x, f.y) for f in forces]).reshape(-1, 2),
        np.concatenate([np.asarray(f.constants, dtype=float) for f in forces]),
        ends,
        frame,
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        tuple(functions),
    )
