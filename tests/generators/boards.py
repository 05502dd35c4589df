"""Pictures of a checkerboard through a pinhole with radial distortion, ray by ray; swimid is not used."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

#: Truth: focal length and centre, px; k1 and k2; size of the pictures, px.
FOCAL, CENTRE, LENS, SIZE = 300.0, (166.0, 116.0), (-0.25, 0.08), (320, 240)
SQUARES, SQUARE_M = (9, 6), 0.025


def _rotation(x: float, y: float, z: float) -> np.ndarray:
    turns = []
    for k, angle in enumerate((x, y, z)):
        turn, (i, j) = np.eye(3), [n for n in range(3) if n != k]
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
        turns.append(turn)
    return turns[0] @ turns[1] @ turns[2]


def write(folder: Path, count: int = 12, *, tilt_deg: float = 30.0, seed: int = 0) -> Path:
    """Write pictures of a board that is tilted up to ``tilt_deg`` about both axes; return the folder."""
    folder.mkdir()
    rng, (width, height) = np.random.default_rng(seed), SIZE
    row, column = (np.mgrid[: 2 * height, : 2 * width] + 0.5) / 2 - 0.5
    # The ray of a pixel, by fixed-point iteration of the distortion.
    seen = np.stack([(column - CENTRE[0]) / FOCAL, (row - CENTRE[1]) / FOCAL])
    ray = seen.copy()
    for _ in range(8):
        square = np.sum(ray**2, axis=0)
        ray = seen / (1 + LENS[0] * square + LENS[1] * square**2)
    ray = np.concatenate([ray, np.ones((1, *ray.shape[1:]))])
    for k in range(count):
        x, y = np.radians(rng.uniform(-tilt_deg, tilt_deg, 2))
        turn = _rotation(x, y, np.radians(rng.uniform(-15, 15)))
        middle = np.array([rng.uniform(-0.07, 0.07), rng.uniform(-0.05, 0.05), rng.uniform(0.36, 0.45)])
        normal = turn[:, 2]
        away = (normal @ middle) / np.tensordot(normal, ray, 1)
        on = np.tensordot(turn.T, ray * away - middle[:, None, None], 1)[:2] / SQUARE_M
        across, down = on[0] + SQUARES[0] / 2, on[1] + SQUARES[1] / 2
        inside = (across > 0) & (across < SQUARES[0]) & (down > 0) & (down < SQUARES[1])
        dark = inside & ((np.floor(across) + np.floor(down)) % 2 == 0)
        picture = cv2.resize(np.where(dark, 30.0, 220.0), SIZE, interpolation=cv2.INTER_AREA)
        picture = cv2.GaussianBlur(picture, (3, 3), 0.6) + rng.normal(0, 2, picture.shape)
        cv2.imwrite(str(folder / f"{k:02d}.png"), np.clip(picture, 0, 255).astype(np.uint8))
    return folder
