"""Moving vehicles as they were seen, gathered frame by frame: which of the candidates moved is known at the end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.detection.appearance import Floats, describe
from vtrack_batch.detection.candidates import Candidates, grid_steps, reduced
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import Place
from vtrack_batch.model.homography import Array

_CAR_M = (3.6, 5.8)
_MOST_A_FRAME, _MOST_FRAMES, _MOST_EXAMPLES = 40, 60, 400


@dataclass(eq=False)
class Examples:
    """Car-sized strict candidates of some frames, described as they were seen: which of them moved is known later."""

    every: int
    _frames: dict[int, tuple[NDArray[np.int64], Floats, Array]] = field(default_factory=dict)

    @staticmethod
    def of(frames: int) -> Examples:
        """Return a collection for a block of so many *frames*."""
        return Examples(max(1, -(-frames // _MOST_FRAMES)))

    def add(
        self,
        frame: int,
        pixels: NDArray[np.uint8],
        found: Candidates,
        metres_per_px: tuple[float, float],
        params: DetectionParams,
    ) -> None:
        """Describe the candidates *found* in the frame with number *frame*; only some frames are used."""
        if frame % self.every or not params.standing:
            return
        scale = np.array(metres_per_px)
        along = np.stack([found.lx_px, found.ly_px], axis=1) * scale
        across = np.stack([found.wx_px, found.wy_px], axis=1) * scale
        size = 2 * np.stack([np.linalg.norm(along, axis=1), np.linalg.norm(across, axis=1)], axis=1)
        good = (found.score >= params.example_score) & (found.flags == 0)
        rows = np.nonzero(good & (size[:, 0] > _CAR_M[0]) & (size[:, 0] < _CAR_M[1]))[0]
        rows = rows[:: max(1, -(-len(rows) // _MOST_A_FRAME))]
        centre = np.stack([found.col_px, found.row_px], axis=1)[rows]
        self._frames[frame] = (rows, _described(pixels, centre, along[rows], metres_per_px, params), size[rows])

    def moving(self, place: Place) -> tuple[Floats, Array]:
        """Return the descriptions (n, ...) and sizes (n, 2) in metres of those that belong to chains of *place*."""
        parts = []
        for frame, (rows, looks, size) in sorted(self._frames.items()):
            moves = np.isin(rows, place.chained[frame])
            parts.append((looks[moves], size[moves]))
        if not parts:
            return np.zeros((0, 1, 1, 1), np.float32), np.zeros((0, 2))
        looks, sizes = (np.concatenate(part) for part in zip(*parts, strict=True))
        thinned = slice(None, None, max(1, -(-len(looks) // _MOST_EXAMPLES)))
        return looks[thinned], sizes[thinned]


def _described(
    pixels: NDArray[np.uint8],
    centre_px: Array,
    along_m: Array,
    metres_per_px: tuple[float, float],
    params: DetectionParams,
) -> Floats:
    steps = grid_steps(params, metres_per_px)
    picture = reduced(pixels, steps)
    centre = (centre_px - (np.array(steps) - 1) / 2) / steps
    return describe(picture, centre, along_m, (1 / metres_per_px[0] / steps[0], 1 / metres_per_px[1] / steps[1]))
