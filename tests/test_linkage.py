"""Least squares for chains of tracked points: exact films, and covariances in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swimid.points import linkage as links
from swimid.points import point_files
from swimid.points.linkage import Linkage, State
from swimid.robots.planar import MultilinkRobot

SD = 0.002


def solved(chain: Linkage, seen: np.ndarray, used: np.ndarray) -> tuple[State, links.Residuals]:
    """Return states and residuals of frames, from a start that is turned and shifted a little."""
    weight = np.where(used, SD**-2, 0.0)
    angles = np.full((len(seen), len(chain.parent)), 0.05)
    state = links.solve_linkage(chain, seen, weight, State(seen[:, 0] + 0.01j, angles))
    return state, links.residuals(chain, seen, weight, np.full(seen.shape, SD**2), state)


def test_the_angles_of_an_exact_film_are_found() -> None:
    """Three links of 0.2, 0.1 and 0.3 m behind a nose; the points are placed here by hand."""
    chain = links.chain(("nose", "a", "b", "c"), np.array([0.2, 0.1, 0.3]))
    heading, first, second = np.array([0.4, -0.3]), np.array([0.2, 0.1]), np.array([-0.5, 0.3])
    nose = np.array([0.3 + 0.1j, -0.2 + 0.4j])
    a = nose - 0.2 * np.exp(1j * heading)
    b = a - 0.1 * np.exp(1j * (heading + first))
    c = b - 0.3 * np.exp(1j * (heading + first + second))
    seen = np.column_stack([nose, a, b, c])
    state, left = solved(chain, seen, np.ones(seen.shape, dtype=bool))
    np.testing.assert_allclose(state.angles, np.column_stack([heading, first, second]), atol=1e-6)
    np.testing.assert_allclose(state.position, nose, atol=1e-6)
    np.testing.assert_allclose(links.predict_points(chain, state), seen, atol=1e-6)
    assert chain.redundancy == 8 - 5
    assert chain.size == pytest.approx(0.6)
    assert left.known.all()
    # in pixels
    scaled = replace(chain, scale=500.0)
    state, _ = solved(scaled, 500.0 * seen, np.ones(seen.shape, dtype=bool))
    np.testing.assert_allclose(state.angles, np.column_stack([heading, first, second]), atol=1e-6)


def test_two_points_determine_place_and_heading_as_in_closed_form() -> None:
    """Along the link both points measure the place; across it the first one does; the heading has both."""
    chain, length = links.chain(("front", "rear"), np.array([0.25])), 0.25
    # the distance of the points is 1 mm too long
    seen = np.array([[0.5 + 0.2j, 0.5 + 0.2j - (length + 0.001) * np.exp(0.0j)]])
    state, found = solved(chain, seen, np.ones((1, 2), dtype=bool))
    assert state.angles[0, 0] == pytest.approx(0.0, abs=1e-6)
    expected = np.array([[0.5, 0.0, 0.0], [0.0, 1.0, 1.0 / length], [0.0, 1.0 / length, 2.0 / length**2]])
    np.testing.assert_allclose(found.covariance[0], SD**2 * expected, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.value[0], [0.0005, -0.0005], atol=1e-6)
    np.testing.assert_allclose(np.sort(found.share, axis=2)[0], [[0.0, 0.5], [0.0, 0.5]], atol=1e-9)
    assert found.freedom.tolist() == [[1, 1]]
    # a residual of half the error, over the standard deviation of a half of the variance
    np.testing.assert_allclose(found.squares[0], (0.0005 / SD) ** 2 / 0.5, rtol=1e-4)


def test_a_point_behind_an_unseen_bend_is_tested_along_its_link_only() -> None:
    """The joint is unknown without the tail, which is no outlier wherever it is on its circle."""
    chain = links.chain(("nose", "middle", "tail"), np.array([0.2, 0.3]))
    seen = np.array([[0j, -0.2 + 0j, -0.5 + 0.02j], [0j, -0.2 + 0j, -0.52 + 0.0j]])
    used = np.array([[True, True, False]] * 2)
    weight = np.where(used, SD**-2, 0.0)
    state = State(seen[:, 0], np.zeros((2, 2)))
    found = links.residuals(chain, seen, weight, np.full(seen.shape, SD**2), state)
    assert found.known.tolist() == [[True, True, True, False]] * 2
    assert found.freedom[:, 2].tolist() == [1, 1]
    # along the link: noise of the tail, and the mean of the two other points
    assert found.squares[0, 2] == pytest.approx(0.0, abs=1e-9)
    assert found.squares[1, 2] == pytest.approx((0.02 / SD) ** 2 / 1.5, rel=1e-6)


def test_an_uncertain_scale_adds_to_the_covariance() -> None:
    """The states change with the scale; the covariance gains the square of this change."""
    chain = links.chain(("nose", "a", "b"), np.array([0.2, 0.3]))
    pixels, sd = replace(chain, scale=400.0, free=frozenset({"scale"})), 0.01
    angles = np.array([[0.3, -0.4]])
    seen = links.predict_points(pixels, State(np.array([50 + 20j]), angles))
    weight = np.ones(seen.shape)

    def at(scale: float) -> np.ndarray:
        found = links.solve_linkage(
            replace(pixels, scale=scale), seen, weight, State(np.array([50 + 20j]), angles)
        )
        return np.concatenate([found.position.real, found.position.imag, found.angles[0]])

    state = State(np.array([50 + 20j]), angles)
    known = links.residuals(pixels, seen, weight, weight, state).covariance[0]
    uncertain = replace(pixels, covariance=np.array([[sd**2]]))
    found = links.residuals(uncertain, seen, weight, weight, state)
    change = (at(400.0 * np.exp(1e-4)) - at(400.0 * np.exp(-1e-4))) / 2e-4
    np.testing.assert_allclose(
        found.covariance[0], known + sd**2 * np.outer(change, change), rtol=1e-3, atol=1e-8
    )
    np.testing.assert_allclose(found.cross[0, :, 0], sd**2 * change, rtol=1e-3, atol=1e-8)
    np.testing.assert_allclose(found.alone[0], np.diag(known), rtol=1e-9)


def test_points_on_rigid_and_moving_links_of_a_robot() -> None:
    """A nose, a neck fixed to it at 30 degrees, a mast fixed to the neck at 20 more, and a moving tail."""
    body = MultilinkRobot.model_validate(
        {
            "plane": "horizontal",
            "reference": {"station_m": 0.05, "offset_m": 0.01},
            "links": [
                {
                    "name": name,
                    "length_m": length,
                    "mass_kg": 1.0,
                    "com_m": 0.01,
                    "inertia_kg_m2": 0.01,
                    "inertia_about": "com",
                }
                for name, length in (("nose", 0.2), ("neck", 0.1), ("mast", 0.3), ("tail", 0.4))
            ],
            "joints": [
                {"name": "a", "parent": "nose", "child": "neck", "mount_deg": 30.0},
                {
                    "name": "b",
                    "parent": "neck",
                    "child": "mast",
                    "mount_deg": 20.0,
                    "at_m": 0.04,
                    "offset_m": 0.02,
                },
                {"name": "c", "parent": "mast", "child": "tail", "mount_deg": -15.0, "driven": {}},
            ],
            "points": {
                "tip": {"link": "nose", "at_m": [0.0, 0.0]},
                "top": {"link": "mast", "at_m": [-0.3, 0.05]},
                "end": {"link": "tail", "at_m": [-0.4, 0.0]},
            },
        }
    )
    found = point_files.linkage_of(body, body.points, "robot.yaml")
    heading, bend = 0.7, -0.3
    neck = -0.2 + 0j
    mast = neck + (-0.04 + 0.02j) * np.exp(1j * np.radians(30))
    tail = mast - 0.3 * np.exp(1j * np.radians(50))
    body_axes = [
        0j,
        mast + (-0.3 + 0.05j) * np.exp(1j * np.radians(50)),
        tail - 0.4 * np.exp(1j * (np.radians(35) + bend)),
    ]
    reference = -0.05 + 0.01j
    expected = 2 + 3j + (np.array(body_axes) - reference) * np.exp(1j * heading)
    state = State(np.array([2 + 3j]), np.array([[heading, bend]]))
    np.testing.assert_allclose(links.predict_points(found, state)[0], expected, atol=1e-12)
    assert found.names == ("tip", "top", "end")
    assert found.columns == ("joint1_rad",)
    assert found.links == ("nose", "tail")
