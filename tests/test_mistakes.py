"""Corrections of usual recording mistakes, applied to a trial of a fish."""

from __future__ import annotations

import numpy as np
import pytest

from swimid.fitting import drives, mistakes
from swimid.fitting.model import SwimInput, Trial
from swimid.rig.model import make_towed_model
from swimid.robots import file as robots
from swimid.swimmer.planar.model import MultilinkModel

TIME = np.arange(0.0, 2.0, 0.02)


def beat(size: float) -> drives.Motion:
    return lambda time: (size * np.sin(time), size * np.cos(time), -size * np.sin(time))


@pytest.fixture(scope="module")
def trial() -> Trial:
    measured = {"x_m": TIME, "y_m": 2.0 * TIME, "yaw_rad": 0.1 * TIME, "u_m_s": 0.5 + 0.0 * TIME}
    swim = SwimInput(joints=[beat(0.1), beat(0.2), beat(0.3)], commanded=True, pose=(0.0, 0.5, 0.25))
    return Trial("run", "fit", TIME, measured, swim=swim)


@pytest.fixture(scope="module")
def undone(trial: Trial) -> dict[str, Trial | None]:
    found = mistakes.list_mistakes(MultilinkModel(robots.read("tfish")), [trial])
    return {one.says: one.undo(trial) for one in found}


def sizes(trial: Trial | None) -> list[float]:
    """Return the amplitude of each driven joint."""
    assert trial is not None
    assert trial.swim.joints is not None
    return [float(np.asarray(joint(np.array([np.pi / 2]))[0])[0]) for joint in trial.swim.joints]


@pytest.mark.parametrize("number", [1, 2, 3])
def test_the_sign_of_one_joint_changes(undone: dict[str, Trial | None], number: int) -> None:
    expected = [0.1, 0.2, 0.3]
    expected[number - 1] *= -1
    assert sizes(undone[f"the sign of driven joint {number} changed"]) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("says", "changes"),
    [
        ("yaw + 180 degrees", {"yaw_rad": 0.1 * TIME + np.pi}),
        ("yaw mirrored", {"yaw_rad": -0.1 * TIME}),
        ("y mirrored", {"y_m": -2.0 * TIME}),
        ("the sign of u_m_s changed", {"u_m_s": -0.5 + 0.0 * TIME}),
        ("yaw_rad taken as degrees", {"yaw_rad": np.radians(0.1 * TIME)}),
        ("yaw_rad multiplied by 180/pi", {"yaw_rad": np.degrees(0.1 * TIME)}),
    ],
)
def test_channels_are_corrected(
    undone: dict[str, Trial | None], trial: Trial, says: str, changes: dict[str, np.ndarray]
) -> None:
    found = undone[says]
    assert found is not None
    for name, values in {**trial.measured, **changes}.items():
        np.testing.assert_allclose(found.measured[name], values, atol=1e-12)
    assert sizes(found) == pytest.approx([0.1, 0.2, 0.3])


def test_the_sign_of_a_measured_force_is_among_the_mistakes() -> None:
    given = Trial("tow", "fit", TIME, {"x_m": TIME}, {"force_N": 2.0 + TIME})
    model = make_towed_model(mass_kg=8.0, force_N=1.0, area_known=False)
    found = {one.says: one.undo(given) for one in mistakes.list_mistakes(model, [given])}
    turned = found["the sign of force_N changed"]
    assert turned is not None
    np.testing.assert_array_equal(turned.inputs["force_N"], -2.0 - TIME)
    np.testing.assert_array_equal(turned.measured["x_m"], TIME)
