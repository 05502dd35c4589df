"""Estimation of a film of tracked points: states, noise of each point, faults, and global quantities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swimid.points.film import Film, FilmEstimate
from swimid.points.film_bias import find_undetermined, remove_bias
from swimid.points.film_faults import (
    Fault,
    exchange_back,
    exchange_labels,
    find_faults,
    is_mirrored,
    list_faults,
)
from swimid.points.film_states import choose_states
from swimid.points.linkage import Array, Flags, Linkage, Residuals, State


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
        Estimated standard deviation of the errors of the stated places of points, m; 0 if the places are not
        estimated.
    undetermined : ndarray, shape (2 * points, k)
        Orthonormal directions in the space of the places (x of all points, then y) that the film does not
        determine.
    faults : list of Fault
    level : float
        Probability that a correct point in a single frame is removed by chance.
    order : ndarray of int, shape (n, points)
        Index of the label with which each point was tracked. It differs from the index of the point where an
        exchange of two labels was undone.
    ambiguous : ndarray of bool, shape (n, 2 + links)
        Whether a component of the state is ambiguous: another state, with another value of the component,
        fits the points of the frame as well.
    mirrored : bool
        Whether the stated places of the points fit the mirrored picture better.
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
    The noise of each point is estimated from its residuals by restricted maximum likelihood: the
    sum of the squared residuals is divided by the sum of their redundancies, and not by their number
    (Foerstner 1979). The first estimates are robust: medians of normalised residuals.
    """
    estimate = FilmEstimate.of(film, linkage)
    estimate.begin()
    find_faults(estimate)
    if exchange_labels(estimate, linkage):
        find_faults(estimate)
    if exchange_back(estimate):
        find_faults(estimate)
    ambiguous = choose_states(estimate)
    information = remove_bias(estimate)
    residuals = estimate.residuals()
    return FilmFit(
        estimate.linkage,
        estimate.state,
        residuals,
        estimate.used,
        estimate.noise,
        estimate.exponent,
        estimate.place_sd_m,
        find_undetermined(estimate, information),
        list_faults(estimate, residuals),
        estimate.level,
        estimate.order,
        ambiguous,
        is_mirrored(estimate),
    )
