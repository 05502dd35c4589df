"""Weighted least squares for the pose and the joint angles of a linkage from tracked points.

Points, joints and the base of a linkage are complex numbers: x + iy, in the plane of motion. The state of a
frame is the position of the reference point, in the unit of the tracked points, and the angles: the heading
of the base and one angle for each moving joint. The Jacobian is analytic, and all frames are solved together.

Global quantities belong to the whole film: the scale, the lengths of the links of a chain, and the places of
the points on their links. They are estimated together with the states of all frames (bundle adjustment). The
states are eliminated by the Schur complement (Triggs et al. 2000, doi:10.1007/3-540-44480-7_21).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

#: Number of frames that are solved in one block, which limits the memory.
BLOCK = 2000
#: Maximum number of steps of the solver. A frame has converged if a further step decreases the weighted sum
#: of squares by less than DECREASE. A deviation of one standard deviation changes the sum by 1.
MAX_STEPS, DECREASE = 40, 1e-7
#: Eigenvalues of a scaled normal matrix below this fraction of its largest eigenvalue count as zero.
SINGULAR = 1e-10
#: Variance of a direction of the state that the points do not determine, relative to the square of the size
#: of the linkage. This large variance is used in place of an infinite one.
UNKNOWN = 1e4


@dataclass(frozen=True)
class Linkage:
    """Tree of rigid links with points on them. Links that are rigidly connected are one link.

    Attributes
    ----------
    names : tuple of str
        Names of the points.
    link : ndarray of int, shape (points,)
        Index of the link of each point. Parents precede their children; the base is link 0.
    place : ndarray of complex, shape (points,)
        Place of each point in the axes of its link, m: x forward, y to port.
    parent : ndarray of int, shape (links,)
        Index of the parent of each link; -1 for the base.
    joint : ndarray of complex, shape (links,)
        Joint of each link in the axes of its parent, m.
    mount : ndarray, shape (links,)
        Angle of each link relative to its parent at zero joint angle, rad.
    columns : tuple of str
        Column of the log of the joint of each link but the base.
    links : tuple of str
        Names of the links.
    reference : complex
        Reference point of the pose in the axes of the base, m.
    rear : ndarray of complex, shape (links,)
        Rear end of each link in its axes, m.
    scale : float
        Length of a metre in the unit of the tracked points.
    free : frozenset of str
        Global quantities to estimate: ``scale``, ``lengths`` (of a chain), ``places`` (of the points).
    covariance : ndarray, shape (m, m)
        Covariance of the global quantities; empty before they are estimated.
    """

    names: tuple[str, ...]
    link: NDArray[np.intp]
    place: Complex
    parent: NDArray[np.intp]
    joint: Complex
    mount: Array
    columns: tuple[str, ...]
    links: tuple[str, ...]
    reference: complex
    rear: Complex
    scale: float = 1.0
    free: frozenset[str] = frozenset()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def part(self, names: Sequence[str]) -> Linkage:
        """Return a linkage that has only the named points, in the order of ``names``."""
        rows = [self.names.index(name) for name in names]
        return replace(self, names=tuple(names), link=self.link[rows], place=self.place[rows])

    @property
    def size(self) -> float:
        """Length of the straight linkage from its reference point to its farthest point, m."""
        return float(np.abs(self.shape(np.zeros((1, len(self.parent))))[2]).max())

    @property
    def redundancy(self) -> int:
        """Number of coordinates of the points in a frame beyond those that determine a bent linkage."""
        angles = np.random.default_rng(0).uniform(-1.0, 1.0, (1, len(self.parent)))
        bent = State(np.zeros(1, dtype=complex), angles)
        slopes = _derivatives(replace(self, free=frozenset()), bent)[1][0]
        real = np.concatenate([slopes.real, slopes.imag])
        return len(real) - int(np.linalg.matrix_rank(real))

    @property
    def carries(self) -> Flags:
        """Whether each link carries each point, itself or by links behind it, shape (links, points)."""
        found = np.zeros((len(self.parent), len(self.link)), dtype=bool)
        for point, link in enumerate(self.link):
            while link >= 0:
                found[link, point] = True
                link = self.parent[link]
        return found

    def shape(self, angles: Array) -> tuple[Complex, Complex, Complex]:
        """Return axes and origins of the links, and the points, relative to the reference point, m.

        Parameters
        ----------
        angles : ndarray, shape (n, links)
            Heading, and the angle of each joint, rad.

        Returns
        -------
        axes, origins : ndarray of complex, shape (n, links)
            Direction of the x axis of each link, and its front end.
        points : ndarray of complex, shape (n, points)
        """
        axes = np.empty(angles.shape, dtype=complex)
        origins = np.empty(angles.shape, dtype=complex)
        axes[:, 0] = np.exp(1j * angles[:, 0])
        origins[:, 0] = -axes[:, 0] * self.reference
        for k in range(1, len(self.parent)):
            up = self.parent[k]
            axes[:, k] = axes[:, up] * np.exp(1j * (self.mount[k] + angles[:, k]))
            origins[:, k] = origins[:, up] + axes[:, up] * self.joint[k]
        return axes, origins, origins[:, self.link] + axes[:, self.link] * self.place

    def turns(self) -> Array:
        """Return the derivatives of points for a rotation of each link that has only one joint about it.

        Returns
        -------
        ndarray, shape (2 * points, k)
            Displacements of all points (x, then y) for each of k links.
        """
        found = []
        for link in range(len(self.parent)):
            joints = list(self.joint[np.asarray(self.parent) == link])
            if link:
                joints.append(0j)
            if len(joints) == 1:
                turn = np.where(self.link == link, 1j * (self.place - joints[0]), 0j)
                found.append(np.concatenate([turn.real, turn.imag]))
        return np.array(found).T.reshape(2 * len(self.link), len(found))

    # ------------------------------------------------------------ global quantities

    @property
    def quantities(self) -> list[str]:
        """Names of the global quantities that are estimated, in the order of their covariance."""
        names = ["scale"] * ("scale" in self.free)
        if "lengths" in self.free:
            names += [f"length {name}" for name in self.links]
        if "places" in self.free:
            names += [f"{name} {axis}" for axis in "xy" for name in self.names]
        return names

    @property
    def values(self) -> Array:
        """Values of the global quantities: logarithm of the scale, lengths and places in m, shape (m,)."""
        parts = [np.zeros(0)]
        if "scale" in self.free:
            parts.append(np.array([np.log(self.scale)]))
        if "lengths" in self.free:
            parts.append(-self.rear.real)
        if "places" in self.free:
            parts += [self.place.real, self.place.imag]
        return np.concatenate(parts)

    def sensitivity(self, axes: Complex, points: Complex) -> Complex:
        """Return the derivatives of points with respect to the m global quantities, shape (n, points, m).

        The scale is represented by its logarithm.
        """
        n, p = points.shape
        parts: list[Complex] = []
        if "scale" in self.free:
            parts.append(self.scale * points[..., None])
        if "lengths" in self.free:
            # A longer link moves its own rear point and all points behind it.
            behind = (self.carries & (self.place != 0)).T
            parts.append(-self.scale * axes[:, None, :] * behind)
        if "places" in self.free:
            turned = np.zeros((n, p, p), dtype=complex)
            turned[:, np.arange(p), np.arange(p)] = self.scale * axes[:, self.link]
            parts += [turned, 1j * turned]
        return np.concatenate([np.zeros((n, p, 0), dtype=complex), *parts], axis=2)

    def apply_step(self, step: Array, covariance: Array) -> Linkage:
        """Return a linkage whose global quantities are changed by a step, with their covariance."""
        step = step.copy()
        found = replace(self, covariance=covariance)
        if "scale" in self.free:
            found = replace(found, scale=found.scale * float(np.exp(step[0])))
            step = step[1:]
        if "lengths" in self.free:
            count = len(self.parent)
            rear = found.rear - step[:count]
            joint = np.concatenate([[0j], rear[:-1]])
            found = replace(found, rear=rear, joint=joint, place=np.concatenate([[0j], rear]))
            step = step[count:]
        if "places" in self.free:
            x, y = step.reshape(2, -1)
            found = replace(found, place=found.place + x + 1j * y)
        return found


def chain(names: tuple[str, ...], lengths: Array) -> Linkage:
    """Return the linkage of a chain of points from front to rear, with a link between successive points.

    The reference point is the first point. There is a joint at each inner point. The joints are numbered from
    the front.
    """
    rear = -np.asarray(lengths, dtype=complex)
    count = len(rear)
    link, place = np.maximum(np.arange(count + 1) - 1, 0), np.concatenate([[0j], rear])
    tree = (np.arange(count) - 1, place[:-1], np.zeros(count))
    columns = tuple(f"joint{k}_rad" for k in range(1, count))
    links = tuple(f"{a} to {b}" for a, b in pairwise(names))
    return Linkage(names, link, place, *tree, columns, links, 0j, rear, free=frozenset({"lengths"}))


@dataclass
class State:
    """States of all frames: position of the reference point, and heading and joint angles, rad."""

    position: Complex
    angles: Array

    def __getitem__(self, rows: slice | NDArray[np.intp] | Flags) -> State:
        return State(self.position[rows], self.angles[rows])

    def __setitem__(self, rows: slice | NDArray[np.intp] | Flags, other: State) -> None:
        self.position[rows], self.angles[rows] = other.position, other.angles

    @property
    def components(self) -> Array:
        """Position and angles as real numbers, shape (n, 2 + links)."""
        return np.column_stack([self.position.real, self.position.imag, self.angles])

    def add_steps(self, step: Array) -> State:
        """Return the states changed by steps, shape (n, 2 + links)."""
        return State(self.position + step[:, 0] + 1j * step[:, 1], self.angles + step[:, 2:])


def blocks(count: int) -> Iterator[slice]:
    """Yield slices of at most :data:`BLOCK` frames that cover all frames."""
    for start in range(0, count, BLOCK):
        yield slice(start, min(start + BLOCK, count))


def predict_points(linkage: Linkage, state: State) -> Complex:
    """Return the points of a linkage, in the unit of the tracked points, shape (n, points)."""
    return np.asarray(state.position[:, None] + linkage.scale * linkage.shape(state.angles)[2])


def _derivatives(linkage: Linkage, state: State) -> tuple[Complex, Complex, Complex]:
    """Return the points, and their derivatives with respect to the state and to the global quantities."""
    axes, origins, points = linkage.shape(state.angles)
    n, p = points.shape
    slopes = np.ones((n, p, 2 + len(linkage.parent)), dtype=complex)
    slopes[:, :, 1] = 1j
    slopes[:, :, 2] = 1j * linkage.scale * points
    carries = linkage.carries
    for k in range(1, len(linkage.parent)):
        slopes[:, :, 2 + k] = 1j * linkage.scale * (points - origins[:, k : k + 1]) * carries[k]
    whole = state.position[:, None] + linkage.scale * points
    return whole, slopes, linkage.sensitivity(axes, points)


def _inner(a: Complex, weight: Array, b: Complex) -> Array:
    """Return, for each frame, the weighted sum over its points of the products of two sets of derivatives."""
    return np.asarray((np.swapaxes(a.conj() * weight[..., None], 1, 2) @ b).real)


def solve_linkage(
    linkage: Linkage, seen: Complex, weight: Array, state: State, steps: int = MAX_STEPS
) -> State:
    """Return the states with the smallest weighted sum of squared residuals, by Levenberg-Marquardt.

    Parameters
    ----------
    seen : ndarray of complex, shape (n, points)
        Tracked points. Those with zero weight may have any finite value.
    weight : ndarray, shape (n, points)
        Reciprocal variance of each coordinate of each point; 0 for points that are not used.
    state : State
        Start values. In directions that the points do not determine, the state keeps its start value.
    """
    found = State(state.position.copy(), state.angles.copy())
    for rows in blocks(len(seen)):
        found[rows] = _solve(linkage, seen[rows], weight[rows], found[rows], steps)
    return found


def cost(linkage: Linkage, seen: Complex, weight: Array, state: State) -> Array:
    """Return the weighted sum of the squared residuals of each frame, shape (n,)."""
    return np.asarray(np.sum(weight * np.abs(seen - predict_points(linkage, state)) ** 2, axis=1))


def _solve(linkage: Linkage, seen: Complex, weight: Array, state: State, steps: int) -> State:
    damping, active = np.full(len(seen), 1e-4), np.arange(len(seen))
    before = cost(linkage, seen, weight, state)
    for _ in range(steps):
        y, w, now = seen[active], weight[active], state[active]
        points, slopes, _ = _derivatives(linkage, now)
        normal = _inner(slopes, w, slopes)
        right = _inner(slopes, w, (y - points)[..., None])
        ridge = np.einsum("nii->ni", normal)
        floor = 1e-12 * ridge.max(axis=1, keepdims=True) + 1e-300
        damped = normal + np.eye(normal.shape[1]) * (damping[active, None] * ridge + floor)[:, None]
        step = np.linalg.solve(damped, right)[..., 0]
        moved = now.add_steps(step)
        new = cost(linkage, y, w, moved)
        better = new <= before[active]
        state[active[better]] = moved[better]
        gain = np.sum(step * right[..., 0], axis=1)
        before[active[better]] = new[better]
        damping[active] = np.where(better, 0.1 * damping[active], 10.0 * damping[active])
        active = active[(gain > DECREASE) & (damping[active] < 1e8)]
        if not len(active):
            break
    return state


# ---------------------------------------------------------------- residuals and their covariance


@dataclass
class Residuals:
    """Residuals of the tracked points, and the covariance of states and residuals.

    Attributes
    ----------
    value : ndarray of complex, shape (n, points)
        Tracked minus predicted point.
    share : ndarray, shape (n, points, 2)
        Fractions of the variance of a point that remain in its residual (redundancy), along two
        perpendicular axes, for points that are used.
    normalised : ndarray, shape (n, points, 2)
        Residuals along these axes, divided by their standard deviations; 0 along an axis without redundancy.
        For a point that is not used, the standard deviation is that of its prediction and its noise together.
    freedom : ndarray of int, shape (n, points)
        Number of axes with redundancy: degrees of freedom of the sum of squares of ``normalised``.
    covariance : ndarray, shape (n, d, d)
        Covariance of the d components of the state of each frame, including the uncertainty of the m global
        quantities; 0 in directions that the points do not determine.
    alone : ndarray, shape (n, d)
        Variances of the state if the global quantities were known exactly.
    cross : ndarray, shape (n, d, m)
        Covariance of the state and the global quantities.
    known : ndarray of bool, shape (n, d)
        Whether the points of a frame determine each component of its state.
    """

    value: Complex
    share: Array
    normalised: Array
    freedom: NDArray[np.int64]
    covariance: Array
    alone: Array
    cross: Array
    known: Flags

    @property
    def squares(self) -> Array:
        """Sum of the squared normalised residuals of each point, shape (n, points)."""
        return np.asarray(np.sum(self.normalised**2, axis=2))


#: Minimum redundancy (fraction of the variance of a point that remains in its residual) along an axis.
#: Residuals with less redundancy are not used.
MIN_SHARE = 0.01


def residuals(linkage: Linkage, seen: Complex, weight: Array, variance: Array, state: State) -> Residuals:
    """Return the residuals of the points with their covariance, and the covariance of the states.

    Parameters
    ----------
    variance : ndarray, shape (n, points)
        Variance of each coordinate of each point, also of those that are not used.
    """
    parts = [
        _residuals(linkage, seen[rows], weight[rows], variance[rows], state[rows])
        for rows in blocks(len(seen))
    ]
    names = Residuals.__dataclass_fields__
    return Residuals(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _inverses(linkage: Linkage, normal: Array) -> tuple[Array, Array, Flags]:
    """Return pseudo-inverses of normal matrices, projectors on null spaces, flags of known components."""
    scale = np.ones(normal.shape[1])
    scale[2:] = 1.0 / (linkage.scale * linkage.size)
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    null = values <= SINGULAR * np.maximum(values[:, -1:], 1e-300)
    inverse = np.where(null, 0.0, 1.0 / np.where(null, 1.0, values))
    turned = scale[:, None] * vectors
    pseudo = (turned * inverse[:, None, :]) @ np.swapaxes(turned, 1, 2)
    empty = (turned * null[:, None, :]) @ np.swapaxes(turned, 1, 2)
    known = np.sum(np.where(null[:, None, :], vectors, 0.0) ** 2, axis=2) < 1e-6
    return pseudo, empty, known


def _residuals(linkage: Linkage, seen: Complex, weight: Array, variance: Array, state: State) -> Residuals:
    points, slopes, common = _derivatives(linkage, state)
    value = seen - points
    pseudo, empty, known = _inverses(linkage, _inner(slopes, weight, slopes))
    gain = pseudo @ _inner(slopes, weight, common)
    cross = np.zeros_like(gain)
    covariance = pseudo
    if linkage.covariance.size:
        cross = -gain @ linkage.covariance
        covariance = pseudo - cross @ np.swapaxes(gain, 1, 2)
    # The covariance of a residual is the noise minus the variance of the fit for a point that is used, and
    # the noise plus the variance of the prediction for a point that is not used.
    used = weight > 0
    reach = (linkage.scale * linkage.size) ** 2
    spread = np.where(used[..., None, None], -1.0, 1.0) * _of_points(slopes, pseudo)
    spread += np.where(used, 0.0, UNKNOWN * reach)[..., None, None] * _of_points(slopes, empty)
    share = np.eye(2) + spread / variance[..., None, None]
    values, axes = np.linalg.eigh(share)
    pair = np.stack([value.real, value.imag], axis=-1)
    along = np.einsum("npij,npi->npj", axes, pair)
    tested = (values > MIN_SHARE) & (values < UNKNOWN)
    normalised = np.where(tested, along / np.sqrt(np.where(tested, values, 1.0) * variance[..., None]), 0.0)
    alone = np.einsum("nii->ni", pseudo)
    return Residuals(value, values, normalised, tested.sum(axis=2), covariance, alone, cross, known)


def _of_points(slopes: Complex, covariance: Array) -> Array:
    """Return the covariance of points that follows from that of the states, shape (n, points, 2, 2)."""
    real = np.stack([slopes.real, slopes.imag], axis=2)
    return np.asarray(np.einsum("npia,nab,npjb->npij", real, covariance, real, optimize=True))


# ---------------------------------------------------------------- global quantities


@dataclass
class Scores:
    """Derivatives of half the weighted sum of squares with respect to the global quantities.

    The states are eliminated.

    Attributes
    ----------
    value : ndarray, shape (n, m)
        Negative derivatives with respect to the m global quantities, for each frame.
    normal : ndarray, shape (m, m)
        Normal matrix of the global quantities, in the approximation of Gauss and Newton.
    gain : ndarray, shape (n, d, m)
        Negative derivative of the d components of the state of each frame with respect to the global
        quantities.
    rest : ndarray, shape (n, d)
        Step of the state of each frame if the global quantities do not change.
    """

    value: Array
    normal: Array
    gain: Array
    rest: Array

    def score_covariance(self, axes: Array) -> Array:
        """Return the covariance of the sum of the scores along axes, shape (k, k).

        The variances are enlarged if the sums of the scores over blocks of successive frames vary more than
        for independent frames, because errors of a tracker are correlated in time (Liang and Zeger 1986,
        doi:10.1093/biomet/73.1.13).

        Parameters
        ----------
        axes : ndarray, shape (m, k)
            Directions in the space of the global quantities.
        """
        off = (self.value - self.value.mean(axis=0)) @ axes
        alone, groups = off.T @ off, int(np.sqrt(len(off)))
        if groups < MIN_GROUPS:
            return np.asarray(alone)
        sums = np.array([part.sum(axis=0) for part in np.array_split(off, groups)])
        together = np.sum(sums**2, axis=0) * groups / (groups - 1)
        wider = np.sqrt(np.maximum(together / np.maximum(np.diag(alone), 1e-300), 1.0))
        return np.asarray(alone * wider[:, None] * wider)


def scores(linkage: Linkage, seen: Complex, weight: Array, state: State) -> Scores:
    """Return the derivatives of half the weighted sum of squares with respect to the global quantities."""
    count = len(linkage.quantities)
    normal, parts = np.zeros((count, count)), []
    for rows in blocks(len(seen)):
        w = weight[rows]
        points, slopes, common = _derivatives(linkage, state[rows])
        off = (seen[rows] - points)[..., None]
        mixed = _inner(slopes, w, common)
        pseudo = _inverses(linkage, _inner(slopes, w, slopes))[0]
        gain, rest = pseudo @ mixed, (pseudo @ _inner(slopes, w, off))[..., 0]
        value = _inner(common, w, off)[..., 0] - np.einsum("ndm,nd->nm", mixed, rest)
        normal = normal + (_inner(common, w, common) - np.swapaxes(mixed, 1, 2) @ gain).sum(axis=0)
        parts.append((value, gain, rest))
    value, gain, rest = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Scores(value, normal, gain, rest)


def invert_normal_matrix(normal: Array) -> Array:
    """Return the pseudo-inverse of a normal matrix of the global quantities, which have different units."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    sizes = np.outer(size, size)
    return np.asarray(np.linalg.pinv(normal / sizes, rcond=SINGULAR, hermitian=True)) / sizes


#: Minimum number of blocks of frames for an estimate of the variance of the scores between blocks.
MIN_GROUPS = 10


# ---------------------------------------------------------------- start values


def start(linkage: Linkage, time_s: Array, seen: Complex, used: Flags) -> State:
    """Return start values of the states from closed forms, without iterations.

    The base is placed by Procrustes' method on its points (Umeyama 1991, doi:10.1109/34.88573), or on all
    points of the straight linkage if it has fewer than two. Each further link is turned about its joint in
    the same way, from the base to the rear. Gaps are interpolated in time.
    """
    n, links = len(seen), len(linkage.parent)
    straight = linkage.shape(np.zeros((1, links)))
    position, angles = np.full(n, np.nan, dtype=complex), np.zeros((n, links))
    own = linkage.link == 0
    places = straight[2][0]
    if own.sum() < 2 or not (used & own).sum(axis=1).max(initial=0) >= 2:
        own = np.ones(len(own), dtype=bool)
    y, q, w = seen[:, own], places[own], used[:, own]
    number = np.maximum(w.sum(axis=1), 1)
    middle, centre = (y * w).sum(axis=1) / number, (w @ q) / number
    product = np.sum(w * (y - middle[:, None]) * np.conj(q - centre[:, None]), axis=1)
    angles[:, 0] = _interpolate_unknown(
        time_s, np.angle(product), (w.sum(axis=1) >= 2) & (np.abs(product) > 0), True
    )
    position = middle - linkage.scale * np.exp(1j * angles[:, 0]) * centre
    there: Flags = np.asarray(w.any(axis=1))
    position = _interpolate_unknown(time_s, position.real, there) + 1j * _interpolate_unknown(
        time_s, position.imag, there
    )
    carries = linkage.carries
    for k in range(1, links):
        axes, origins, _ = linkage.shape(angles)
        pivot = position + linkage.scale * origins[:, k]
        own = linkage.link == k
        if not own.any():
            own = carries[k]
        arm = (places[own] - straight[1][0, k]) * np.conj(straight[0][0, k])
        product = np.sum(used[:, own] * (seen[:, own] - pivot[:, None]) * np.conj(arm), axis=1)
        angle = np.angle(product * np.conj(axes[:, linkage.parent[k]] * np.exp(1j * linkage.mount[k])))
        angles[:, k] = _interpolate_unknown(time_s, angle, np.abs(product) > 0)
    return State(position, angles)


def place_linkage(linkage: Linkage, seen: Complex, weight: Array, joints: Array) -> State:
    """Return the states of a linkage with given joint angles that fit the points best (Procrustes)."""
    angles = np.tile(np.r_[0.0, joints], (len(seen), 1))
    points = linkage.shape(angles)[2]
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    middle, centre = ((weight * one).sum(axis=1, keepdims=True) / total for one in (seen, points))
    product = np.sum(weight * (seen - middle) * np.conj(points - centre), axis=1)
    angles[:, 0] = np.angle(product)
    position = middle[:, 0] - linkage.scale * np.exp(1j * angles[:, 0]) * centre[:, 0]
    return State(position, angles)


def differences(a: Array, b: Array) -> Array:
    """Return the differences of components of states, shape (..., 2 + links), with angles in [-pi, pi)."""
    off = a - b
    off[..., 2:] = (off[..., 2:] + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(off)


def _interpolate_unknown(time_s: Array, values: Array, known: Flags, turns: bool = False) -> Array:
    """Return values with the unknown ones interpolated in time between known ones; 0 if no value is known."""
    if not known.any():
        return np.zeros(len(values))
    good = values[known]
    if turns:
        good = np.unwrap(good)
    return np.asarray(np.interp(time_s, time_s[known], good))


def interpolate_frames(time_s: Array, state: State, good: Flags) -> State:
    """Return the states interpolated in time between the good frames."""
    angles = [_interpolate_unknown(time_s, values, good, True) for values in state.angles.T]
    x, y = (_interpolate_unknown(time_s, part, good) for part in (state.position.real, state.position.imag))
    return State(np.asarray(x + 1j * y, dtype=complex), np.column_stack(angles))
