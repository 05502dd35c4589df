"""Film of tracked points, and the estimate of its states, noise and global quantities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.points import linkage as links
from swimid.points.linkage import Array, Complex, Flags, Linkage, Residuals, State

#: Significance level of the outlier test: probability that, in a film without faults, at least one tracked
#: point is wrongly left out as an outlier.
FALSE_ALARM_POINTS = 0.01
#: Median of the absolute value of a standard normal variable. It converts a median absolute residual to a
#: standard deviation.
HALF_NORMAL = float(special.ndtri(0.75))
#: MAX_ROBUST is the maximum number of robust iterations, MAX_ITERATIONS that of the final fit. Iterations
#: have converged if the relative change of each noise standard deviation is below NOISE_RTOL, and the step of
#: each global quantity below STEP_SE standard errors.
MAX_ROBUST, MAX_ITERATIONS, NOISE_RTOL, STEP_SE = 12, 25, 0.005, 0.05
#: Weight of the prior of the noise of a point, as a number of residuals. The mean of the prior is the noise
#: of all points. The prior matters only if the residuals do not determine the noise of single points.
PRIOR_VALUES = 4.0
#: Minimum noise standard deviation of a point, relative to the length of the linkage. It keeps the weights
#: finite.
MIN_NOISE = 1e-5
#: Maximum exponent p of the noise model, in which the noise is proportional to likelihood^(-p).
MAX_EXPONENT = 5.0
#: Start value of the standard deviation of the places of points that are estimated from the film, m.
PLACE_SD_M = 0.005
#: Number of frames, spread evenly over a film, in which a hypothesis on the whole film (such as a mirrored
#: picture) is tested.
N_SAMPLE_FRAMES = 200


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
        """Return a film that has only the chosen frames."""
        return Film(self.time_s[rows], self.seen[rows], self.there[rows], self.likelihood[rows])

    def put(self, rows: NDArray[np.intp], other: Film) -> None:
        """Replace the points of some frames by those of another film, in place."""
        self.seen[rows], self.there[rows], self.likelihood[rows] = other.seen, other.there, other.likelihood

    def reorder(self, points: list[int]) -> Film:
        """Return a film in which each point is replaced by the one with the given index."""
        return Film(self.time_s, self.seen[:, points], self.there[:, points], self.likelihood[:, points])


class FilmEstimate:
    """Intermediate estimate of a film: states, points that are used, noise and global quantities."""

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
    def of(cls, film: Film, linkage: Linkage) -> FilmEstimate:
        """Return an estimate with start values of the states."""
        return cls(film, linkage, links.start(linkage, film.time_s, film.seen, film.there))

    @property
    def variance(self) -> Array:
        """Variance of a coordinate of each point in each frame, shape (n, points)."""
        return np.asarray(self.noise**2 * np.exp(-2.0 * self.exponent * self.log_likelihood))

    @property
    def sample(self) -> Flags:
        """Flags of about :data:`N_SAMPLE_FRAMES` frames, spread evenly over the film."""
        rows = np.zeros(len(self.used), dtype=bool)
        rows[:: max(len(rows) // N_SAMPLE_FRAMES, 1)] = True
        return rows

    def residuals(self) -> Residuals:
        """Return the residuals of the tracked points, with their covariances, at the present estimate."""
        return links.residuals(self.linkage, self.film.seen, self.weight, self.variance, self.state)

    def is_far(self, found: Residuals) -> Flags:
        """Return whether the residual of each point exceeds the chi-square quantile of the outlier test."""
        limits = np.array([np.inf, *special.chdtri(np.array([1.0, 2.0]), self.level)])
        return np.asarray(found.squares > limits[found.freedom])

    @property
    def weight(self) -> Array:
        """Weight of each point in each frame, 0 where it is not used, shape (n, points)."""
        return np.where(self.used, 1.0 / self.variance, 0.0)

    def solve(self) -> None:
        """Compute the states of all frames from the points that are used."""
        self.state = links.solve_linkage(self.linkage, self.film.seen, self.weight, self.state)

    def begin(self) -> None:
        """Estimate the noise robustly, and the global quantities from frames without outliers."""
        for _ in range(MAX_ROBUST):
            self.solve()
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

    def refine(self) -> None:
        """Estimate noise, likelihood exponent and global quantities from the points that are used."""
        rows = np.ones(len(self.used), dtype=bool)
        for _ in range(MAX_ITERATIONS):
            self.solve()
            moved = self._adjust(rows)
            found = self.residuals()
            relative = np.exp(-2.0 * self.exponent * self.log_likelihood)
            squares = np.where(self.used, np.abs(found.value) ** 2 / relative, 0.0)
            freedom = np.where(self.used, found.share.sum(axis=2), 0.0)
            pooled = squares.sum() / max(freedom.sum(), 1e-300)
            values = (squares.sum(axis=0) + PRIOR_VALUES * pooled) / (freedom.sum(axis=0) + PRIOR_VALUES)
            new = np.maximum(np.sqrt(values), self.floor)
            old_exponent = self.exponent
            self.exponent = self._fit_exponent(squares * relative / new**2, freedom)
            change = np.abs(new / self.noise - 1.0).max()
            self.noise = new
            if max(change, abs(self.exponent - old_exponent)) < NOISE_RTOL and moved < STEP_SE:
                break
        self.solve()

    @property
    def prior(self) -> Array:
        """Step from each global quantity to its prior mean, and precision of the prior, shape (m, 2)."""
        prior = np.zeros((len(self.linkage.quantities), 2))
        if "places" in self.linkage.free:
            off = self.stated - self.linkage.place
            prior[-2 * len(off) :, 0] = np.concatenate([off.real, off.imag])
            prior[-2 * len(off) :, 1] = 1.0 / self.place_sd_m**2
        return prior

    def _adjust(self, rows: Flags) -> float:
        """Improve the global quantities by one step; return its largest component, in standard errors."""
        if not self.linkage.free:
            return 0.0
        weight, prior = np.where(rows[:, None], self.weight, 0.0), self.prior
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

    def _fit_exponent(self, squares: Array, freedom: Array) -> float:
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
