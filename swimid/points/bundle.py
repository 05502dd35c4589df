"""Estimation of a film of tracked points: states, noise of each point, faults, and global quantities.

A fault is a point that does not belong where it was tracked: labels that were exchanged, two labels on one
place, or a stray label. A point is left out of a frame if its residual exceeds a quantile of the chi-square
distribution. The quantile belongs to the probability :data:`FALSE_ALARM_POINTS` that any point of a film
without faults is left out (Bonferroni's bound; data snooping, Baarda 1968).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.points import linkage as links
from swimid.points.linkage import Array, Complex, Flags, Linkage, Residuals, State

#: Probability that at least one point is left out of a film that has no faults.
FALSE_ALARM_POINTS = 0.01
#: Median of the absolute value of a standard normal variable.
HALF_NORMAL = float(special.ndtri(0.75))
#: Maximum number of robust iterations, and of iterations of the final fit; relative change of a noise
#: standard deviation, and step of a global quantity in standard errors, at which they have converged.
MAX_ROBUST, MAX_ITERATIONS, NOISE_RTOL, STEP_SE = 12, 25, 0.005, 0.05
#: Maximum number of times that the faults are searched again with the new noise.
MAX_SEARCHES = 5
#: Exchange of two labels in the whole film: minimum ratio of the largest to the smallest noise of a point
#: from which it is tried, number of points with the largest noise whose labels are exchanged, number of
#: frames in which this is tried, and minimum ratio by which it must reduce the noise.
SUSPICIOUS, SUSPECTS, SAMPLE, MIN_GAIN = 5.0, 4, 200, 1.25
#: Maximum redundancy of a frame in which a third point may be left out in place of two exchanged labels. An
#: exchange contradicts the linkage along four axes, and a point that is left out explains two of them.
FEW = 4
#: Number of values that the prior of the noise of a point is worth. Its mean is that of all points. It acts
#: only where the residuals cannot tell the noise of one point from that of another.
PRIOR_VALUES = 4.0
#: Minimum noise of a point, relative to the length of the linkage.
MIN_NOISE = 1e-5
#: Thresholds of the Geman-McClure weights in the search for the state of a frame with faults, in noise
#: standard deviations (graduated non-convexity, Yang et al. 2020, doi:10.1109/LRA.2020.2965893); number of
#: steps with each of them; and number of the last thresholds that are used if neighbouring frames give the
#: start values.
THRESHOLDS, STEPS, NEAR = (200.0, 80.0, 40.0, 20.0, 10.0, 6.0), 3, 2
#: Difference of the weighted sums of squares of two solutions for a frame, up to which the solution nearer to
#: neighbouring frames is taken: the quantile of the chi-square distribution with one degree of freedom at
#: 0.1 %.
MUCH_WORSE = 10.83
#: Number of frames whose shapes, and their mirror images, are start values in the search for other states
#: that fit a frame; and maximum gap that is bridged between two such states, frames.
N_SHAPES, MAX_GAP = 8, 12
#: Minimum distance of a component of the state from its neighbours that counts as a spike, in 95 %
#: quantiles of the film: 7.8 standard deviations of normal noise, and four times the maximum of a sine.
MAX_SPIKE = 4.0
#: Maximum exponent with which the noise may fall with the likelihood.
MAX_EXPONENT = 5.0
#: Seed of the simulated noise by which the bias of the global quantities is estimated, and number of pairs of
#: simulated films.
SEED, PAIRS, STEP = 20261127, 2, 0.003
#: Minimum fraction of the variance of the stated places that must remain unknown, so that a place counts as
#: not determined by the film.
UNDETERMINED = 0.25
#: Start value of the standard deviation of the places of points that are estimated from the film, m.
PLACE_SD_M = 0.005


@dataclass
class Film:
    """Tracked points of a film.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    seen : ndarray of complex, shape (n, points)
        Tracked points; 0 where missing.
    there : ndarray of bool, shape (n, points)
        Whether each point was tracked.
    likelihood : ndarray, shape (n, points)
        Likelihood of each point; 1 where none is known.
    """

    time_s: Array
    seen: Complex
    there: Flags
    likelihood: Array

    def part(self, rows: Flags | NDArray[np.intp]) -> Film:
        """Return a film of the chosen frames."""
        return Film(self.time_s[rows], self.seen[rows], self.there[rows], self.likelihood[rows])

    def put(self, rows: NDArray[np.intp], other: Film) -> None:
        """Replace the points of some frames by those of another film, in place."""
        self.seen[rows], self.there[rows], self.likelihood[rows] = other.seen, other.there, other.likelihood

    def reorder(self, points: list[int]) -> Film:
        """Return a film whose labels are those of other points, by index."""
        return Film(self.time_s, self.seen[:, points], self.there[:, points], self.likelihood[:, points])


@dataclass
class Fault:
    """Points that were left out for one reason, or exchanged.

    Attributes
    ----------
    kind : str
        ``exchanged`` (and exchanged back), ``merged``, ``stray``, or ``lost`` if more than half of the points
        of a frame disagree.
    names : tuple of str
        Names of the points: one for a stray, two for the others.
    frames : ndarray of int
        Indices of the frames.
    """

    kind: str
    names: tuple[str, ...]
    frames: np.ndarray


@dataclass
class FilmFit:
    """Estimate of a film of tracked points.

    Attributes
    ----------
    linkage : Linkage
        Linkage with its estimated global quantities.
    state : State
    residuals : Residuals
    used : ndarray of bool, shape (n, points)
        Whether each point is used: it was tracked and is no fault.
    noise : ndarray, shape (points,)
        Standard deviation of a coordinate of each point, in the unit of the tracked points, at the median
        likelihood.
    exponent : float
        The noise is proportional to the likelihood to the power of minus this exponent.
    place_sd_m : float
        Estimated standard deviation of the errors of the stated places, m; 0 if they are not estimated.
    undetermined : ndarray, shape (2 * points, k)
        Orthonormal directions in the space of the places (x of all points, then y) that the film does not
        determine.
    faults : list of Fault
    level : float
        Probability of a chance removal for a single point in a single frame.
    order : ndarray of int, shape (n, points)
        Index of the label that shows each point. It differs from the index of the point where two labels were
        exchanged back.
    ambiguous : ndarray of bool, shape (n, 2 + links)
        Whether another state fits the points of a frame as well and has another value of a component.
    mirrored : bool
        Whether the mirrored picture fits the places of the points better.
    """

    linkage: Linkage
    state: State
    residuals: Residuals
    used: Flags
    noise: Array
    exponent: float
    place_sd_m: float
    undetermined: Array
    faults: list[Fault]
    level: float
    order: NDArray[np.intp]
    ambiguous: Flags
    mirrored: bool


def fit_film(film: Film, linkage: Linkage) -> FilmFit:
    """Estimate states, noise, faults and global quantities of a film.

    Parameters
    ----------
    film : Film
    linkage : Linkage
        Linkage with start values of its global quantities.

    Notes
    -----
    The noise of each point is estimated from its residuals by restricted maximum likelihood: the sum of their
    squares is divided by the sum of their redundancies, and not by their number (Foerstner 1979). The first
    estimates are robust: medians of normalised residuals.
    """
    estimate = _Estimate.of(film, linkage)
    estimate.begin()
    estimate.settle()
    if estimate.exchange(linkage):
        estimate.settle()
    if estimate.exchange_back():
        estimate.settle()
    ambiguous = estimate.unfold()
    estimate.remove_bias()
    found = estimate.residuals()
    faults = _faults(estimate, found)
    return FilmFit(
        estimate.linkage,
        estimate.state,
        found,
        estimate.used,
        estimate.noise,
        estimate.exponent,
        estimate.place_sd_m,
        estimate.find_undetermined(),
        faults,
        estimate.level,
        estimate.order,
        ambiguous,
        estimate.is_mirrored(),
    )


class _Estimate:
    """Estimate of a film while it is improved."""

    def __init__(self, film: Film, linkage: Linkage, state: State) -> None:
        self.film, self.linkage, self.state = film, linkage, state
        self.used, self.stated = film.there.copy(), linkage.place
        self.order = np.tile(np.arange(film.seen.shape[1]), (len(film.seen), 1))
        self.floor = MIN_NOISE * linkage.scale * linkage.size
        self.noise = np.full(film.seen.shape[1], 1e3 * self.floor)
        self.exponent, self.place_sd_m = 0.0, 0.0
        self.level = FALSE_ALARM_POINTS / max(int(film.there.sum()), 1)
        usual = np.ones(film.seen.shape[1])
        for k, column in enumerate(film.likelihood.T):
            if film.there[:, k].any():
                usual[k] = np.median(column[film.there[:, k]])
        #: Logarithm of the likelihood relative to the median of its point.
        relative = np.maximum(film.likelihood, 1e-6) / np.maximum(usual, 1e-6)
        self.log_likelihood = np.where(film.there, np.log(relative), 0.0)
        if "places" in linkage.free:
            self.place_sd_m = PLACE_SD_M

    @classmethod
    def of(cls, film: Film, linkage: Linkage) -> _Estimate:
        """Return an estimate with start values of the states."""
        return cls(film, linkage, links.start(linkage, film.time_s, film.seen, film.there))

    @property
    def variance(self) -> Array:
        """Variance of a coordinate of each point in each frame, shape (n, points)."""
        return np.asarray(self.noise**2 * np.exp(-2.0 * self.exponent * self.log_likelihood))

    def residuals(self) -> Residuals:
        """Return residuals and covariances at the present estimate."""
        variance = self.variance
        weight = np.where(self.used, 1.0 / variance, 0.0)
        return links.residuals(self.linkage, self.film.seen, weight, variance, self.state)

    def is_far(self, found: Residuals) -> Flags:
        """Return whether each residual exceeds its quantile of the chi-square distribution."""
        limits = np.array([np.inf, *special.chdtri(np.array([1.0, 2.0]), self.level)])
        return np.asarray(found.squares > limits[found.freedom])

    # ------------------------------------------------------------ start

    def begin(self) -> None:
        """Estimate the noise robustly, and the global quantities from frames without outliers."""
        for _ in range(MAX_ROBUST):
            self._solve()
            found = self.residuals()
            clean: Flags = np.asarray(~(self.is_far(found) & self.used).any(axis=1))
            if clean.mean() < 0.5:
                clean[:] = True
            change = np.ones(len(self.noise))
            for k in range(len(self.noise)):
                rows = clean & self.used[:, k]
                values = np.abs(found.normalised[rows, k])
                values = values[values > 0]
                if len(values):
                    change[k] = np.median(values) / HALF_NORMAL
            new = np.maximum(self.noise * np.clip(change, 0.1, 10.0), self.floor)
            moved = self._adjust(clean)
            settled = np.abs(new / self.noise - 1.0).max() < 10 * NOISE_RTOL and moved < 1.0
            self.noise = new
            if settled:
                break

    def _solve(self) -> None:
        weight = np.where(self.used, 1.0 / self.variance, 0.0)
        self.state = links.solve_linkage(self.linkage, self.film.seen, weight, self.state)

    @property
    def prior(self) -> Array:
        """Step to the stated places and its precision for each global quantity, shape (m, 2)."""
        prior = np.zeros((len(self.linkage.quantities), 2))
        if "places" in self.linkage.free:
            off = self.stated - self.linkage.place
            prior[-2 * len(off) :, 0] = np.concatenate([off.real, off.imag])
            prior[-2 * len(off) :, 1] = 1.0 / self.place_sd_m**2
        return prior

    def _adjust(self, rows: Flags) -> float:
        """Improve the global quantities; return the largest step in standard errors."""
        if not self.linkage.free:
            return 0.0
        weight, prior = np.where(self.used & rows[:, None], 1.0 / self.variance, 0.0), self.prior
        made = links.scores(self.linkage, self.film.seen, weight, self.state)
        covariance = links.invert_normal_matrix(made.normal + np.diag(prior[:, 1]))
        step = covariance @ (made.value.sum(axis=0) + prior[:, 0] * prior[:, 1])
        self.state = self.state.add_steps(made.rest - made.gain @ step)
        self.linkage = self.linkage.apply_step(step, covariance)
        if "places" in self.linkage.free:
            squares = self.prior[:, 0] ** 2 + np.diag(covariance)
            self.place_sd_m = float(np.sqrt(squares[-2 * len(self.noise) :].mean()))
        errors = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        return float(np.max(np.abs(step) / errors))

    def settle(self) -> None:
        """Search faults and refine the estimate in turn until the faults do not change."""
        for _ in range(MAX_SEARCHES):
            before = self.used.copy()
            self.search()
            self.refine()
            if (self.used == before).all():
                break

    def exchange(self, linkage: Linkage) -> bool:
        """Start anew from two labels that are exchanged in the whole film, if that reduces the noise.

        Return whether this was done.

        If labels are wrong in most frames, their noise contains the errors, and no frame stands out. With the
        labels exchanged, the frames in which they were right stand out instead. The search that follows uses
        the labels as they were tracked. A chain has no stated distances that tell which labels are right.

        Parameters
        ----------
        linkage : Linkage
            Linkage with start values of its global quantities.
        """
        if "lengths" in linkage.free or self.noise.max() < SUSPICIOUS * self.noise.min():
            return False
        stated, some = replace(linkage, free=linkage.free - {"places"}), self.film.part(self._some)
        points = range(len(self.noise))
        suspects = np.argsort(-self.noise)[:SUSPECTS].tolist()
        orders = [list(points)]
        for i, j in combinations(suspects, 2):
            order = list(points)
            order[i], order[j] = j, i
            orders.append(order)
        best, found = _least_noise([some.reorder(order) for order in orders], stated)
        if best == 0:
            return False
        whole = _Estimate.of(self.film.reorder(orders[best]), found.linkage)
        whole.noise = self.noise = found.noise
        whole._solve()
        self.place_sd_m = min(self.place_sd_m, PLACE_SD_M)
        self.state = whole.state
        self.linkage = replace(found.linkage, free=linkage.free, covariance=linkage.covariance)
        return True

    @property
    def _some(self) -> Flags:
        """Flags of about :data:`SAMPLE` frames, spread evenly over the film."""
        rows = np.zeros(len(self.used), dtype=bool)
        rows[:: max(len(rows) // SAMPLE, 1)] = True
        return rows

    def is_mirrored(self) -> bool:
        """Return whether some frames fit the stated places better if the picture is mirrored."""
        if "lengths" in self.linkage.free or len(self.noise) < 3:
            return False
        free, unknown = self.linkage.free - {"places"}, np.zeros((0, 0))
        stated = replace(self.linkage, place=self.stated, free=free, covariance=unknown)
        some = self.film.part(self._some)
        return _least_noise([some, replace(some, seen=some.seen.conj())], stated)[0] == 1

    def exchange_back(self) -> bool:
        """Exchange two labels back in frames that then agree with the linkage; return whether any was.

        In such a frame points were left out, and all that can be used agree once two labels are exchanged.
        Their residuals must have two degrees of freedom or more, so that a stray label rarely agrees by
        chance. The frame stays as it is if several exchanges agree.
        """
        rows = np.flatnonzero((self.film.there & ~self.used).any(axis=1))
        if "lengths" in self.linkage.free or not len(rows):
            return False
        agreed, found = np.zeros(len(self.used), dtype=int), []
        # With few points, a third one may be left out in place of two that are exchanged.
        few = self.linkage.redundancy <= FEW
        for i, j in combinations(range(len(self.noise)), 2):
            order = np.arange(len(self.noise))
            order[[i, j]] = j, i
            tried = rows[few | (self.film.there & ~self.used)[rows][:, [i, j]].any(axis=1)]
            if not len(tried):
                continue
            film, used = self.film.part(tried), self.used[tried]
            out = film.there & ~used
            trial = _Estimate.of(film.reorder(order.tolist()), self.linkage)
            trial.noise, trial.exponent, trial.level = self.noise, self.exponent, self.level
            both = out[:, i] & out[:, j] & used.any(axis=1)
            trial.used[both] = used[both]
            trial.used[both, i] = trial.used[both, j] = True
            trial._solve()
            result = trial.residuals()
            agree = ~(trial.is_far(result) & trial.used).any(axis=1) & trial.used[:, i] & trial.used[:, j]
            agree &= np.sum(result.share.sum(axis=2) * trial.used, axis=1) > 2.0 - links.MIN_SHARE
            agreed[tried[agree]] += 1
            found.append((tried, agree, order, trial))
        for tried, agree, order, trial in found:
            mine = agree & (agreed[tried] == 1)
            at = tried[mine]
            self.film.put(at, trial.film.part(mine))
            self.order[at], self.used[at], self.state[at] = order, trial.used[mine], trial.state[mine]
            self.log_likelihood[at] = trial.log_likelihood[mine]
        return bool((agreed == 1).any())

    # ------------------------------------------------------------ faults

    def search(self) -> None:
        """Find the faults of all frames that have outliers or points that were left out."""
        found = self.residuals()
        there = self.film.there
        rows: Flags = np.asarray(((self.is_far(found) | ~self.used) & there).any(axis=1))
        if not rows.any():
            return
        clean: Flags = np.asarray(~rows & there.any(axis=1))
        starts = [self.state[rows]]
        if clean.any():
            starts.append(links.interpolate_frames(self.film.time_s, self.state, clean)[rows])
        inner = _Estimate(self.film.part(rows), self.linkage, starts[0])
        inner.noise, inner.exponent, inner.level = self.noise, self.exponent, self.level
        inner.log_likelihood = self.log_likelihood[rows]
        inner.find_inliers(starts)
        self.used[rows], self.state[rows] = inner.used, inner.state

    def find_inliers(self, starts: list[State]) -> None:
        """Choose the points of each frame that agree with one state of the linkage."""
        there = self.film.there
        found = [self._anneal(starts[0], THRESHOLDS)]
        found += [self._anneal(begin, THRESHOLDS[-NEAR:]) for begin in starts[1:]]
        costs = np.array([cost for _, cost in found])
        costs[1:] -= MUCH_WORSE
        best = np.argmin(costs, axis=0)
        for k, (state, _) in enumerate(found):
            self.state[best == k] = state[best == k]
        off = np.abs(self.film.seen - links.predict_points(self.linkage, self.state)) ** 2 / self.variance
        self.used = there & (off < THRESHOLDS[-1] ** 2)
        self._remove_worst()
        result = self.residuals()
        self.used |= there & ~self.is_far(result) & (result.freedom > 0)
        self._remove_worst()
        # If no more than half of the points agree, the frame does not show which half is right.
        lost = 2 * self.used.sum(axis=1) <= there.sum(axis=1)
        self.used[lost & (self.used != there).any(axis=1)] = False

    def _anneal(self, state: State, thresholds: tuple[float, ...]) -> tuple[State, Array]:
        """Return the states that agree with most points, and their costs, shape (n,)."""
        there, variance = self.film.there, self.variance
        for threshold in thresholds:
            for _ in range(STEPS):
                off = np.abs(self.film.seen - links.predict_points(self.linkage, state)) ** 2 / variance
                weight = np.where(there, (1.0 + off / threshold**2) ** -2 / variance, 0.0)
                state = links.solve_linkage(self.linkage, self.film.seen, weight, state, steps=2)
        off = np.abs(self.film.seen - links.predict_points(self.linkage, state)) ** 2 / variance
        return state, np.sum(np.where(there, np.minimum(off, THRESHOLDS[-1] ** 2), 0.0), axis=1)

    def _remove_worst(self) -> None:
        """Leave out the worst point of each frame until no residual is too large."""
        for _ in range(self.used.shape[1]):
            self._solve()
            found = self.residuals()
            far = self.is_far(found) & self.used
            if not far.any():
                break
            size = np.where(far, found.squares / np.maximum(found.freedom, 1), -1.0)
            rows = np.flatnonzero(far.any(axis=1))
            self.used[rows, np.argmax(size[rows], axis=1)] = False

    # ------------------------------------------------------------ final fit

    def refine(self) -> None:
        """Estimate noise, likelihood exponent and global quantities from the points that are used."""
        rows = np.ones(len(self.used), dtype=bool)
        for _ in range(MAX_ITERATIONS):
            self._solve()
            moved = self._adjust(rows)
            found = self.residuals()
            relative = np.exp(-2.0 * self.exponent * self.log_likelihood)
            squares = np.where(self.used, np.abs(found.value) ** 2 / relative, 0.0)
            freedom = np.where(self.used, found.share.sum(axis=2), 0.0)
            pooled = squares.sum() / max(freedom.sum(), 1e-300)
            values = (squares.sum(axis=0) + PRIOR_VALUES * pooled) / (freedom.sum(axis=0) + PRIOR_VALUES)
            new = np.maximum(np.sqrt(values), self.floor)
            old_exponent = self.exponent
            self.exponent = self._exponent(squares * relative / new**2, freedom)
            change = np.abs(new / self.noise - 1.0).max()
            self.noise = new
            if max(change, abs(self.exponent - old_exponent)) < NOISE_RTOL and moved < STEP_SE:
                break
        self._solve()

    def unfold(self) -> Flags:
        """Choose between the states that fit the points of a frame alike, in frames that lack points.

        Without the points of two successive links these may be bent to either side. The states are searched
        from shapes that the linkage has in other frames, and from their mirror images. The state nearest to
        the one interpolated between frames with all points is taken.

        Returns
        -------
        ndarray of bool, shape (n, 2 + links)
            Components that differ in another state with a sum of squares that is not significantly larger,
            where neighbouring frames do not exclude that state. They exclude a state that is farther from the
            interpolated one than any frame with all points is from its neighbours over the same gap.
            Components of the state that is taken are flagged if they are that far away.
        """
        ambiguous = np.zeros((len(self.used), 2 + len(self.linkage.parent)), dtype=bool)
        seen: Flags = np.asarray(self.used.any(axis=1))
        whole: Flags = np.asarray(self.used.all(axis=1))
        # A point that is astray on the circle about its joint agrees with the others. It shows as a bend of
        # the joint in a single frame.
        at, values = np.flatnonzero(whole), self.state.components[whole]
        if len(at) > MAX_GAP:
            first, last = (links.differences(one, values[1:-1]) for one in (values[:-2], values[2:]))
            share = ((at[1:-1] - at[:-2]) / (at[2:] - at[:-2]))[:, None]
            off = np.abs(first + share * (last - first))
            excess = (off / np.maximum(MAX_SPIKE * np.quantile(off, 0.95, axis=0), 1e-300)).max(axis=1)
            peak = np.maximum(np.r_[0.0, excess[:-1]], np.r_[excess[1:], 0.0])
            whole[at[1:-1]] = (excess <= 1.0) | (excess < peak)
        # If a second state fits all points of a frame, no frame tells which of them is right.
        if (whole & self._some).any() and self._choose(whole & self._some, ~seen)[0].any():
            whole[:] = False
        rows = seen & ~whole
        if rows.any():
            ambiguous[rows], state = self._choose(rows, whole)
            self.state[rows] = state
        return ambiguous

    def _choose(self, rows: Flags, whole: Flags) -> tuple[Flags, State]:
        """Return ambiguous components of the states of some frames, and the states that are taken."""
        weight, seen = np.where(self.used, 1.0 / self.variance, 0.0)[rows], self.film.seen[rows]
        shapes = self.state.angles[np.linspace(0, len(self.used) - 1, N_SHAPES).astype(int), 1:]
        starts = [self.state[rows]]
        bridged = starts[0]
        if whole.any():
            bridged = links.interpolate_frames(self.film.time_s, self.state, whole)[rows]
            starts.append(bridged)
        starts += [links.place_linkage(self.linkage, seen, weight, shape) for shape in (*shapes, *-shapes)]
        found = [links.solve_linkage(self.linkage, seen, weight, start) for start in starts]
        costs = np.array([links.cost(self.linkage, seen, weight, state) for state in found])
        same: Flags = np.asarray(costs <= costs.min(axis=0) + MUCH_WORSE)
        values, near = np.array([state.components for state in found]), bridged.components
        result = self.residuals()
        sd, unknown = np.sqrt(result.alone[rows]), ~result.known[rows]
        size = np.ones(values.shape[2])
        size[:2] = self.linkage.scale * self.linkage.size
        off = links.differences(values, near) / size
        best = np.argmin(np.where(same, np.sum(off**2, axis=2), np.inf), axis=0)
        chosen = values[best, np.arange(len(best))]
        # Two minima differ by more than the sum of squares allows within one of them.
        other: Flags = np.asarray(np.abs(links.differences(values, chosen)) > 4.0 * sd + 1e-3 * size)
        other &= same[:, :, None]
        reach = self._reach(rows, whole) + 4.0 * sd
        far = ~unknown & (np.abs(links.differences(values, near)) > reach)
        likely, astray = np.asarray(~far.any(axis=2)), far[best, np.arange(len(best))]
        rivals = (likely[:, :, None] & other).any(axis=(0, 2)) | astray.any(axis=1)
        flags: Flags = np.asarray(astray | (other.any(axis=0) & np.asarray(rivals)[:, None]))
        return flags, State(chosen[:, 0] + 1j * chosen[:, 1], chosen[:, 2:])

    def _reach(self, rows: Flags, whole: Flags) -> Array:
        """Return twice the usual distance of a whole frame from the state interpolated over a like gap.

        The usual distance is its 95 % quantile. The result is infinite for gaps of more than :data:`MAX_GAP`
        frames, and before the first and after the last whole frame.
        """
        at, frames = np.flatnonzero(whole), np.flatnonzero(rows)
        values = self.state.components
        reach = np.full((len(values), values.shape[1]), np.inf)
        if len(at) < 2:
            return reach[rows]
        after = np.clip(np.searchsorted(at, frames), 1, len(at) - 1)
        gaps = np.maximum(frames - at[after - 1], at[after] - frames)
        outside = (frames < at[0]) | (frames > at[-1])
        for gap in np.unique(gaps[~outside & (gaps <= MAX_GAP)]).tolist():
            middle = np.arange(gap, len(whole) - gap)
            middle = middle[whole[middle] & whole[middle - gap] & whole[middle + gap]]
            first, last = (links.differences(values[middle + k], values[middle]) for k in (-gap, gap))
            if len(middle):
                reach[frames[~outside & (gaps == gap)]] = np.quantile(np.abs(first + last), 0.95, axis=0)
        return reach[rows]

    def remove_bias(self) -> None:
        """Remove the bias that noise gives the global quantities, and compute their covariance.

        Notes
        -----
        Each frame has angles of its own. Noise lengthens the distance of a point from its joint, and with it
        the scale, however many frames there are (Neyman and Scott 1948, doi:10.2307/1914288). The bias of the
        scores is their mean over pairs of simulated films of this motion. The noise of one film is minus that
        of the other, so that all errors that are linear in the noise cancel.

        The curvature of the sum of squares is computed by differences of the scores, with the states solved
        again. The normal matrix would overstate what noisy angles determine.

        The simulated films also give the information without noise. Noise adds to the normal matrix, and
        doubled noise adds it twice (simulation extrapolation, Cook and Stefanski 1994,
        doi:10.1080/01621459.1994.10476871).
        """
        if not self.linkage.free:
            return
        weight, prior = np.where(self.used, 1.0 / self.variance, 0.0), self.prior
        made = links.scores(self.linkage, self.film.seen, weight, self.state)
        rng, bias, noisy = np.random.default_rng(SEED), np.zeros(len(prior)), np.zeros_like(made.normal)
        true = links.predict_points(self.linkage, self.state)
        for _ in range(PAIRS):
            x, y = rng.normal(size=(2, *self.used.shape)) * np.sqrt(self.variance)
            for sign in (1.0, -1.0):
                seen = true + sign * (x + 1j * y)
                state = links.solve_linkage(self.linkage, seen, weight, self.state)
                simulated = links.scores(self.linkage, seen, weight, state)
                bias += simulated.value.sum(axis=0) / (2 * PAIRS)
                noisy += simulated.normal / (2 * PAIRS)
        self.information = 2.0 * made.normal - noisy
        # Differences along the axes of the covariance, by one standard error to either side.
        values, vectors = np.linalg.eigh(links.invert_normal_matrix(made.normal + np.diag(prior[:, 1])))
        kept = values > 0
        axes = vectors[:, kept] * np.sqrt(values[kept])
        columns = []
        for axis in axes.T:
            ends = []
            for sign in (1.0, -1.0):
                moved = self.linkage.apply_step(sign * STEP * axis, self.linkage.covariance)
                begin = self.state.add_steps(-sign * STEP * (made.gain @ axis))
                state = links.solve_linkage(moved, self.film.seen, weight, begin)
                ends.append(links.scores(moved, self.film.seen, weight, state).value.sum(axis=0))
            columns.append(axes.T @ (ends[1] - ends[0]) / (2.0 * STEP))
        of_data, of_prior = np.array(columns), axes.T @ (prior[:, 1:] * axes)
        values, vectors = np.linalg.eigh(0.5 * (of_data + of_data.T))
        bent = (vectors * np.maximum(values, 0.0)) @ vectors.T + of_prior
        inverse = np.linalg.pinv(bent, hermitian=True)
        # In few frames the scores may vary less than their curvature implies.
        spread, least = made.score_covariance(axes), np.maximum(np.diag(of_data), 0.0)
        wider = np.sqrt(np.maximum(least / np.maximum(np.diag(spread), 1e-300), 1.0))
        spread = spread * wider[:, None] * wider
        covariance = axes @ inverse @ (spread + of_prior) @ inverse @ axes.T
        step = axes @ inverse @ axes.T @ (made.value.sum(axis=0) - bias + prior[:, 0] * prior[:, 1])
        self.state = self.state.add_steps(made.rest - made.gain @ step)
        self.linkage = self.linkage.apply_step(step, covariance)
        self._solve()

    def find_undetermined(self) -> Array:
        """Return the directions in the space of the places that the film does not determine.

        A direction counts as determined if the film leaves less than :data:`UNDETERMINED` of the variance of
        the stated places. The errors of the stated places are taken from the directions that the film
        determines better. Rotations of all points of a link about its only joint are left out: no film shows
        the zero of such a joint angle.
        """
        count = 2 * len(self.linkage.names)
        if "places" not in self.linkage.free:
            return np.zeros((count, 0))
        turns = self.linkage.turns()
        axes = np.linalg.svd(turns, full_matrices=True)[0][:, np.linalg.matrix_rank(turns) :]
        own, common = self.information[-count:, -count:], self.information[-count:, :-count]
        if common.size:
            own = own - common @ common.T / self.information[0, 0]
        values, vectors = np.linalg.eigh(axes.T @ own @ axes)
        directions = axes @ vectors
        off = self.linkage.place - self.stated
        moved = directions.T @ np.concatenate([off.real, off.imag])
        error, found = self.place_sd_m**2, 0
        for k in range(len(values)):
            if k + 1 < len(values):
                error = float(np.mean(moved[k + 1 :] ** 2))
            if values[k] * error > 1.0 / UNDETERMINED - 1.0:
                break
            found = k + 1
        return np.asarray(directions[:, :found])

    def _exponent(self, squares: Array, freedom: Array) -> float:
        """Return the exponent of the likelihood in the noise, by maximum likelihood; 0 if not significant.

        ``squares`` are the squared residuals divided by the noise variance at the median likelihood.
        """
        value, slope = self.exponent, self.log_likelihood
        for _ in range(20):
            scaled = squares * np.exp(2.0 * value * slope)
            curvature = 2.0 * float(np.sum(scaled * slope**2))
            if curvature < 1.0:
                return 0.0
            step = float(np.sum(slope * (freedom - scaled))) / curvature
            value = min(max(value + min(max(step, -0.5), 0.5), 0.0), MAX_EXPONENT)
            if abs(step) < 1e-4:
                break
        if value * np.sqrt(curvature) < float(special.ndtri(1 - FALSE_ALARM_POINTS / 2)):
            return 0.0
        return value


def _least_noise(films: list[Film], linkage: Linkage) -> tuple[int, _Estimate]:
    """Fit variants of a film robustly; return index and estimate of the variant with the least noise.

    The result is the first variant, unless another one reduces the noise by the factor :data:`MIN_GAIN`.
    """
    tried = [_Estimate.of(film, linkage) for film in films]
    for trial in tried:
        trial.begin()
    levels = [float(np.log(trial.noise).mean()) for trial in tried]
    best = int(np.argmin(levels))
    if levels[0] - levels[best] < np.log(MIN_GAIN):
        best = 0
    return best, tried[best]


def _faults(estimate: _Estimate, found: Residuals) -> list[Fault]:
    """Return the points that were left out, by reason and names, with their frames."""
    film, names, out = estimate.film, estimate.linkage.names, estimate.film.there & ~estimate.used
    places, variance = links.predict_points(estimate.linkage, estimate.state), estimate.variance
    doubt = np.abs(found.share - 1.0).max(axis=2) * variance
    limit = float(special.chdtri(2.0, estimate.level))
    reach = (estimate.linkage.scale * estimate.linkage.size) ** 2
    kinds: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    moved = estimate.order != np.arange(len(names))
    for row in np.flatnonzero(moved.any(axis=1)).tolist():
        kinds.setdefault(("exchanged", tuple(np.array(names)[moved[row]].tolist())), []).append(row)
    for row in np.flatnonzero(out.any(axis=1)).tolist():
        left = set(np.flatnonzero(out[row]).tolist())
        if not estimate.used[row].any():
            kinds.setdefault(("lost", ()), []).append(row)
            continue
        for i in left:
            away = np.abs(film.seen[row, i] - places[row]) ** 2
            near = (away < limit * (variance[row, i] + doubt[row])) & (doubt[row] < reach)
            near[i] = False
            key: tuple[str, tuple[str, ...]] = ("stray", (names[i],))
            if near.any():
                key = ("merged", (names[i], names[int(np.argmin(np.where(near, away, np.inf)))]))
            kinds.setdefault(key, []).append(row)
    return [Fault(kind, of, np.array(rows)) for (kind, of), rows in kinds.items()]
