"""Films of a tendon-driven fish as trials: markers on the head, the tail and the fin, filmed from above.

    python -m tests.generators.sprung_tail DATA FOLDER

DATA is the folder ``fishsim`` of the recordings. They are not part of this project. The camera looks down;
the picture's y axis points down. The distance of the two markers on the rigid head sets the scale.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

#: Beats as they are stated, Hz, and which are held out: those between the slowest and the fastest.
FILMS = {"0_50": "fit", "1_00": "validate", "1_75": "validate", "2_00": "fit"}
RATE_HZ, HEAD_M = 60.0, 0.142


def write(data: Path, folder: Path, robot: str = "sprung-tail.yaml") -> Path:
    """Write logs and a trials file whose drive has the measured beat, and the amplitude of the fitted films.

    One amplitude serves all films: half the stroke of the tail in the two fitted ones, on average.
    """
    folder.mkdir(parents=True, exist_ok=True)
    beats, amplitudes = {}, []
    for film, role in FILMS.items():
        points = np.genfromtxt(data / f"markers_f{film}.csv", delimiter=",").reshape(-1, 9, 2)
        points[:, :, 1] *= -1.0
        points *= HEAD_M / np.median(np.hypot(*(points[:, 1] - points[:, 0]).T))
        time = np.arange(len(points)) / RATE_HZ
        yaw, tail, fin = (_heading(points, *pair) for pair in ((0, 1), (2, 7), (7, 8)))
        nominal = 0.75 * float(film.replace("_", "."))
        beats[film] = _beat(time, tail - yaw, nominal)
        if role == "fit":
            amplitudes.append(_amplitude(time, tail - yaw, beats[film])[0])
        bend = fin - tail
        columns = (time, points[:, 0] - points[0, 0], yaw, bend - bend.mean())
        header = "t_s,x_m,y_m,yaw_rad,joint2_rad"
        np.savetxt(
            folder / f"f{film}.csv",
            np.column_stack(columns),
            delimiter=",",
            header=header,
            comments="",
            fmt="%.5f",
        )
    lines = ["format: swimid-trials/1", "experiment: free-swim", f"robot: {robot}", "trials:"]
    lines += [
        f"  - {{id: f{film}, log: f{film}.csv, role: {role}, start_state: steady, drive: {{frequency_hz: "
        f"{beats[film]:.4f}, amplitude_deg: {np.degrees(np.mean(amplitudes)):.2f}}}}}"
        for film, role in FILMS.items()
    ]
    path = folder / "trials.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _heading(points: np.ndarray, front: int, rear: int) -> np.ndarray:
    forward = points[:, front] - points[:, rear]
    return np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))


def _amplitude(time_s: np.ndarray, angle: np.ndarray, frequency_hz: float) -> tuple[float, float]:
    """Amplitude of the beat, and the sum of squares that a sine with a trend leaves."""
    turn = 2.0 * np.pi * frequency_hz * time_s
    design = np.column_stack((np.cos(turn), np.sin(turn), np.ones_like(turn), time_s))
    weights, left, *_ = np.linalg.lstsq(design, angle, rcond=None)
    return float(np.hypot(*weights[:2])), float(left[0])


def _beat(time_s: np.ndarray, angle: np.ndarray, nominal_hz: float) -> float:
    """Frequency near a nominal one at which a sine fits best, Hz."""
    tried = nominal_hz * np.linspace(0.9, 1.1, 801)
    return float(tried[int(np.argmin([_amplitude(time_s, angle, f)[1] for f in tried]))])


if __name__ == "__main__":
    print(write(Path(sys.argv[1]), Path(sys.argv[2])))
