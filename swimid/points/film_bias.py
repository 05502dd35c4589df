"""Bias and covariance of the global quantities of a film of tracked points."""

from __future__ import annotations

import numpy as np

from swimid.points import linkage as links
from swimid.points.film import FilmEstimate
from swimid.points.linkage import Array

#: Constants of the estimate of the bias of the global quantities: SEED of the simulated noise, number PAIRS
#: of pairs of simulated films, and STEP of the differences of the scores in standard errors.
SEED, PAIRS, STEP = 20261127, 2, 0.003
#: Fraction of the prior variance of the stated places of points. If the film leaves at least this fraction in
#: a direction, it does not determine that direction.
UNDETERMINED = 0.25


def remove_bias(estimate: FilmEstimate) -> Array:
    """Remove the bias that noise gives the global quantities, and compute their covariance.

    Return the Fisher information that the film without noise would have on these m quantities, shape (m, m).

    Notes
    -----
    Each frame has angles of its own. Noise lengthens the estimated distance of a point from its
    joint, and thus changes the scale, however many frames there are (Neyman and Scott 1948,
    doi:10.2307/1914288). The bias of the scores is their mean over pairs of simulated films of this motion.
    In each pair, the noise of one film is minus that of the other, so that all errors that are linear in the
    noise cancel.

    The curvature of the sum of squares is computed by differences of the scores, with the states solved
    again. The normal matrix would overstate the information in noisy angles. The simulated films also give
    the information without noise: noise adds a term to the normal matrix, and twice the noise variance adds
    twice this term, so that the term can be subtracted (simulation extrapolation, Cook and Stefanski 1994,
    doi:10.1080/01621459.1994.10476871).
    """
    if not estimate.linkage.free:
        return np.zeros((0, 0))
    weight, prior = estimate.weight, estimate.prior
    made = links.scores(estimate.linkage, estimate.film.seen, weight, estimate.state)
    rng, bias, noisy = np.random.default_rng(SEED), np.zeros(len(prior)), np.zeros_like(made.normal)
    true = links.predict_points(estimate.linkage, estimate.state)
    for _ in range(PAIRS):
        x, y = rng.normal(size=(2, *estimate.used.shape)) * np.sqrt(estimate.variance)
        for sign in (1.0, -1.0):
            seen = true + sign * (x + 1j * y)
            state = links.solve_linkage(estimate.linkage, seen, weight, estimate.state)
            simulated = links.scores(estimate.linkage, seen, weight, state)
            bias += simulated.value.sum(axis=0) / (2 * PAIRS)
            noisy += simulated.normal / (2 * PAIRS)
    information = 2.0 * made.normal - noisy
    # Compute differences of the scores along the principal axes of the covariance. Each axis is one standard
    # error long.
    values, vectors = np.linalg.eigh(links.invert_normal_matrix(made.normal + np.diag(prior[:, 1])))
    kept = values > 0
    axes = vectors[:, kept] * np.sqrt(values[kept])
    columns = []
    for axis in axes.T:
        ends = []
        for sign in (1.0, -1.0):
            moved = estimate.linkage.apply_step(sign * STEP * axis, estimate.linkage.covariance)
            begin = estimate.state.add_steps(-sign * STEP * (made.gain @ axis))
            state = links.solve_linkage(moved, estimate.film.seen, weight, begin)
            ends.append(links.scores(moved, estimate.film.seen, weight, state).value.sum(axis=0))
        columns.append(axes.T @ (ends[1] - ends[0]) / (2.0 * STEP))
    of_data, of_prior = np.array(columns), axes.T @ (prior[:, 1:] * axes)
    values, vectors = np.linalg.eigh(0.5 * (of_data + of_data.T))
    bent = (vectors * np.maximum(values, 0.0)) @ vectors.T + of_prior
    inverse = np.linalg.pinv(bent, hermitian=True)
    # In a film of few frames the scores may vary less than the curvature of the sum of squares implies.
    spread, least = made.score_covariance(axes), np.maximum(np.diag(of_data), 0.0)
    wider = np.sqrt(np.maximum(least / np.maximum(np.diag(spread), 1e-300), 1.0))
    spread = spread * wider[:, None] * wider
    covariance = axes @ inverse @ (spread + of_prior) @ inverse @ axes.T
    step = axes @ inverse @ axes.T @ (made.value.sum(axis=0) - bias + prior[:, 0] * prior[:, 1])
    estimate.state = estimate.state.add_steps(made.rest - made.gain @ step)
    estimate.linkage = estimate.linkage.apply_step(step, covariance)
    estimate.solve()
    return information


def find_undetermined(estimate: FilmEstimate, information: Array) -> Array:
    """Return the directions in the space of the places that the film does not determine.

    A direction counts as determined if the film leaves less than the fraction :data:`UNDETERMINED` of the
    variance of the stated places. This variance is estimated from the directions that the film determines
    better. Rotations of all points of a link about its only joint are left out: no film shows the zero of
    such a joint angle.
    """
    count = 2 * len(estimate.linkage.names)
    if "places" not in estimate.linkage.free:
        return np.zeros((count, 0))
    turns = estimate.linkage.turns()
    axes = np.linalg.svd(turns, full_matrices=True)[0][:, np.linalg.matrix_rank(turns) :]
    own, common = information[-count:, -count:], information[-count:, :-count]
    if common.size:
        own = own - common @ common.T / information[0, 0]
    values, vectors = np.linalg.eigh(axes.T @ own @ axes)
    directions = axes @ vectors
    off = estimate.linkage.place - estimate.stated
    moved = directions.T @ np.concatenate([off.real, off.imag])
    error, found = estimate.place_sd_m**2, 0
    for k in range(len(values)):
        if k + 1 < len(values):
            error = float(np.mean(moved[k + 1 :] ** 2))
        if values[k] * error > 1.0 / UNDETERMINED - 1.0:
            break
        found = k + 1
    return np.asarray(directions[:, :found])
