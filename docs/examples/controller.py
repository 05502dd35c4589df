"""Tune a PI controller of the speed on an identified discrete-time model.

python docs/examples/controller.py

The controller u = K (e + sum(e) T / T_i), with the error e and the sample time T, has the largest integral
gain among those with a stable loop and a largest sensitivity of 1.4 (Astrom and Hagglund 2006, Advanced PID
Control, chapter 6): it lets a constant disturbance through the least, with a phase margin of 41 deg and a
gain margin of 3.5 or more.
"""

from __future__ import annotations

import math
import warnings

import control
import numpy as np

import swimid
from swimid.blackbox.model import to_control

MAX_SENSITIVITY = 1.4
N_FREQUENCIES, N_GAINS, N_BISECTIONS, N_DRAWS = 4000, 160, 50, 200


def pi(gain: float, integral: float, step_s: float) -> control.TransferFunction:
    """Return K + K_i T z / (z - 1)."""
    return control.TransferFunction([gain + integral * step_s, -gain], [1.0, -1.0], step_s)


def is_stable(plant: control.TransferFunction, gain: float, integral: float) -> bool:
    """Return whether the closed loop is stable."""
    numerator, denominator = np.ravel(plant.num[0][0]), np.ravel(plant.den[0][0])
    loop = np.polymul(numerator, [gain + integral * plant.dt, -gain])
    closed = np.polyadd(loop, np.polymul(denominator, [1.0, -1.0]))
    return bool(np.abs(np.roots(closed)).max() < 1.0)


def tune(plant: control.TransferFunction) -> tuple[float, float]:
    """Return proportional and integral gain of the controller with the largest integral gain."""
    if np.abs(plant.poles()).max() >= 1.0:
        raise ValueError(f"the model is unstable (a pole of {np.abs(plant.poles()).max():.4f})")
    sign = math.copysign(1.0, float(np.real(plant(1.0))))
    z = np.exp(1j * math.pi * np.geomspace(1e-5, 1.0, N_FREQUENCIES))
    response, sums = sign * plant(z), plant.dt * z / (z - 1.0)
    size = 1.0 / float(np.abs(response).max())
    best = (0.0, 0.0)
    for gain in np.concatenate(([0.0], size * np.geomspace(1e-2, 1e2, N_GAINS))):
        low, high = 0.0, 10.0 * size / plant.dt
        for _ in range(N_BISECTIONS):
            middle = 0.5 * (low + high)
            sensitivity = np.max(1.0 / np.abs(1.0 + response * (gain + middle * sums)))
            if sensitivity <= MAX_SENSITIVITY and is_stable(plant, sign * gain, sign * middle):
                low = middle
            else:
                high = middle
        if low > best[1] * (1.0 + 1e-9):
            best = (float(gain), low)
    return sign * best[0], sign * best[1]


def drawn(arma: swimid.Fitted, seed: int = 0) -> list[control.TransferFunction]:
    """Return the model with draws of its coefficients from their covariance."""
    names = list(arma.correlation.index)
    known = arma.parameters.loc[names]
    covariance = arma.correlation * np.outer(known["stderr"], known["stderr"])
    rng = np.random.default_rng(seed)
    models = []
    for values in rng.multivariate_normal(known["value"], covariance, N_DRAWS):
        moved = arma.file.model_copy(deep=True)
        for name, value in zip(names, values, strict=True):
            moved.parameters[name].value = value
        models.append(to_control(moved))
    return models


def main() -> None:
    """Identify the long fin's marching, tune, and say what the loop is worth."""
    arma = swimid.rwls(
        ["sample_logs/longfin/longfin_marching.csv"],
        input_column="cmd1_rad",
        output_column="u_m_s",
        na=4,
        nb=3,
    )
    plant = to_control(arma.file)
    gain, integral = tune(plant)
    print(f"PI controller: gain {gain:.3g}, integral time {gain / integral:.3g} s")
    loop = control.minreal(plant * pi(gain, integral, plant.dt), verbose=False)
    margins = control.stability_margins(loop)
    print(f"gain margin {margins[0]:.3g}, phase margin {margins[1]:.3g} deg")
    models = drawn(arma)
    steady = np.quantile([float(np.real(model(1.0))) for model in models], [0.025, 0.975])
    stable = np.mean([is_stable(model, gain, integral) for model in models])
    print(f"steady gain {float(np.real(plant(1.0))):.3g} m/s/rad (95 %: {steady[0]:.3g} to {steady[1]:.3g})")
    print(f"stable in {100 * stable:.0f} % of draws of the coefficients")


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", swimid.SwimidWarning)
        main()
