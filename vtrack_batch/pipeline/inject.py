"""Completeness of a unit: its samples painted with known vehicles, background and detections made anew from them.

The very functions that made the unit's detections are asked again, so what they find of the painted vehicles is what
they would find of real ones. A vehicle that stands is painted into all samples of its stay before the background is
learned: it may become background, as real ones do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.background.learn import Background, learn_background
from vtrack_batch.background.stacks import Sample
from vtrack_batch.completeness.boxes import boxes_of, corners_of, mapped
from vtrack_batch.completeness.donors import Canvas, Donor, cut, erase, paint
from vtrack_batch.completeness.injection import Glimpse, Injections, lone, plan_injections
from vtrack_batch.completeness.motion import moving, stays_of
from vtrack_batch.completeness.sightings import came_back, paint_of
from vtrack_batch.completeness.table import INJECTIONS
from vtrack_batch.config.survey import Survey
from vtrack_batch.detection.candidates import Candidates, find_candidates
from vtrack_batch.detection.lanes import Lanes
from vtrack_batch.detection.place import Place, select
from vtrack_batch.model import homography
from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.homography import Array
from vtrack_batch.pipeline.block import Block
from vtrack_batch.pipeline.plan import FrameRef
from vtrack_batch.pipeline.reading import Reader
from vtrack_batch.pipeline.samples import sample_store, seconds
from vtrack_batch.registration.bending import Bend, straighten
from vtrack_batch.storage.parquet import empty_frame

_ERASED_M = 0.3
_MOST_DONORS = 400
_MOST_COPIES = 8


@dataclass(frozen=True)
class Seen:
    """One frame of the unit as it was detected."""

    ref: FrameRef
    pose: Array
    bend: Bend | None
    """What was taken out of the frame before ``pose`` and ``vehicles``, None = nothing."""
    vehicles: Candidates


@dataclass(frozen=True)
class Detected:
    """A unit as it was detected: what is needed to detect in some of its frames again."""

    block: Block
    background: Background
    lanes: Lanes | None
    """None where all directions are tried."""
    place: Place | None
    """None where no frame could be used."""
    frames: Sequence[Seen]


Frames = Callable[[], Iterable[Sample]]
"""Gives one frame after the other."""


@dataclass(frozen=True)
class Stock:
    """Vehicles that can be painted: cut out, the axis of each in reference px, and its paint."""

    donors: Sequence[Donor]
    axes: Array
    paint: NDArray[np.object_]


def inject(
    detected: Detected, sampled: Sequence[FrameRef], halo: Frames, reader: Reader, survey: Survey, folder: Path
) -> pd.DataFrame:
    """Return table ``injections`` of the unit: empty where nothing moves that could be cut out.

    *sampled* are the frames of the background: those of the unit are painted, those of the *halo* stay as they are.
    What does not fit into one copy of the frames goes into another, up to eight. Copies wait in *folder*.
    """
    # what stands in the background cannot be painted over: it is not seen against it
    detected = replace(detected, frames=[replace(seen, vehicles=_seen_to_differ(seen)) for seen in detected.frames])
    names = {ref.frame_id for ref in sampled}
    numbers = [n for n, seen in enumerate(detected.frames) if seen.ref.frame_id in names]
    if not numbers or detected.place is None:
        return empty_frame(INJECTIONS)
    glimpses = _glimpses(detected, survey.completeness.stand_s)
    stock = _stock(detected, numbers, glimpses, reader)
    tables = [_real(detected, n, glimpses[n]) for n in numbers]
    left = survey.completeness.injections_per_unit if stock.donors else 0
    for again in range(_MOST_COPIES):
        if left <= 0:
            break
        copy = Copy(again, detected, glimpses, numbers, stock, survey)
        found = copy.found(reader, halo, folder, most=left)
        tables.append(found)
        left -= max(len(found), 1)
    return pd.concat(tables, ignore_index=True)


@dataclass(frozen=True)
class Copy:
    """One copy of the sampled frames, by ``numbers`` in ``glimpses``: painted, and detected again."""

    again: int
    detected: Detected
    glimpses: Sequence[Glimpse]
    numbers: Sequence[int]
    stock: Stock
    survey: Survey

    def found(self, reader: Reader, halo: Frames, folder: Path, *, most: int) -> pd.DataFrame:
        """Paint up to about *most* vehicles; return their rows of the table."""
        plan = plan_injections(
            self.glimpses,
            self.numbers,
            self.stock.axes,
            metres_per_px=self.detected.block.metres_per_px,
            params=self.survey.completeness.model_copy(update={"injections_per_unit": most}),
            seed=(_second(self.detected.frames[0].ref), self.again),
        )
        samples, done = [], []
        with sample_store(folder, (len(plan) + 1) * 3 * math.prod(self.detected.block.size)) as keep:
            for n, injections in zip(self.numbers, plan, strict=True):
                canvas = _canvas(self.detected, n, reader)
                done.append(_painted(canvas, self.glimpses[n], injections, self.stock.donors))
                taken_s = seconds(self.detected.frames[n].ref)
                samples.append(Sample(keep(canvas.pixels), self.glimpses[n].pose, taken_s))
            whole = [*samples, *(replace(sample, pixels=keep(sample.pixels[:])) for sample in halo())]
            scale = float(np.mean(self.detected.block.metres_per_px))
            background = learn_background(whole, params=self.survey.background, metres_per_px=scale)
            tables = [
                self._rows(n, injections, painted, self._detected_anew(sample, background))
                for n, injections, painted, sample in zip(self.numbers, plan, done, samples, strict=True)
            ]
        return pd.concat(tables, ignore_index=True)

    def _detected_anew(self, sample: Sample, background: Background) -> Candidates:
        place, pose, params = self.detected.place, sample.frame_to_reference, self.survey.detection.alone()
        assert place is not None
        scale = self.detected.block.metres_per_px
        tried = self.detected.lanes.tried_in(pose) if self.detected.lanes else None
        found = find_candidates(sample.pixels[:], pose, background, metres_per_px=scale, params=params, tried=tried)
        # chains of others say nothing of what is painted
        alone = replace(place, chained=(np.zeros(0, np.int64),))
        return found.take(select(found, pose, alone, frame=0, params=params))

    def _rows(self, number: int, injections: Injections, painted: NDArray[np.bool_], again: Candidates) -> pd.DataFrame:
        seen = self.detected.frames[number]
        to_ground = self.detected.block.fix.reference_to_ground @ seen.pose
        placed = homography.apply(to_ground, injections.boxes[:, :2])
        others = homography.apply(to_ground, boxes_of(seen.vehicles)[~injections.replaced, :2])
        found = homography.apply(to_ground, boxes_of(again)[:, :2])
        back = came_back(placed, others, found, self.survey.completeness.gate_m)
        unit, name = self.detected.frames[0].ref.frame_id, f"{seen.ref.frame_id}-{self.again}"
        ranks = range(len(placed))
        rows = pd.DataFrame(
            {
                "sighting_id": [f"{name}-{rank:04d}" for rank in ranks],
                "x_m": placed[:, 0],
                "y_m": placed[:, 1],
                "painted": True,
                "stands": injections.stay >= 0,
                "stay": [
                    f"{name}-{rank:04d}" if stay < 0 else f"{unit}-{self.again}-{stay}"
                    for rank, stay in zip(ranks, injections.stay, strict=True)
                ],
                "paint": self.stock.paint[injections.donor],
                "found": back >= 0,
            }
        )
        return rows[painted].assign(t_utc=pd.Timestamp(seen.ref.t_utc, tz="UTC"))


def _real(detected: Detected, number: int, glimpse: Glimpse) -> pd.DataFrame:
    """Return rows of the table for what was really found in a frame."""
    seen = detected.frames[number]
    at = homography.apply(detected.block.fix.reference_to_ground @ seen.pose, glimpse.boxes[:, :2])
    found = seen.vehicles
    return pd.DataFrame(
        {
            "sighting_id": [f"{seen.ref.frame_id}-{rank:04d}" for rank in range(len(at))],
            "t_utc": pd.Timestamp(seen.ref.t_utc, tz="UTC"),
            "x_m": at[:, 0],
            "y_m": at[:, 1],
            "painted": False,
            "stands": glimpse.stay >= 0,
            "stay": "",
            "paint": paint_of(found.red, found.green, found.blue),
            "found": True,
        }
    )


def _seen_to_differ(seen: Seen) -> Candidates:
    return seen.vehicles.take((seen.vehicles.flags & DetectionFlag.IN_BACKGROUND) == 0)


def _second(ref: FrameRef) -> int:
    return int(seconds(ref))


# what was seen, what can be painted -----------------------------------------------------------------------------------


def _glimpses(detected: Detected, stand_s: float) -> list[Glimpse]:
    """Return what was found in the frames of the unit."""
    start = detected.frames[0].ref.t_utc
    times_s = np.array([(seen.ref.t_utc - start) / np.timedelta64(1, "s") for seen in detected.frames])
    kept = [seen.vehicles for seen in detected.frames]
    scale = np.array([*detected.block.metres_per_px] * 3)
    boxes_m = [mapped(boxes_of(found), seen.pose) * scale for found, seen in zip(kept, detected.frames, strict=True)]
    colours = [np.stack([found.red, found.green, found.blue], axis=1) for found in kept]
    stays = stays_of([boxes[:, :2] for boxes in boxes_m], times_s, stand_s)
    going = moving(boxes_m, colours, times_s)
    return [
        Glimpse(float(t_s), seen.pose, boxes_of(found), stay, driven & (stay < 0))
        for t_s, seen, found, stay, driven in zip(times_s, detected.frames, kept, stays, going, strict=True)
    ]


def _canvas(detected: Detected, number: int, reader: Reader) -> Canvas:
    """Read a frame again, and see the ground below it."""
    seen, background = detected.frames[number], detected.background
    pixels = reader.pixels(seen.ref, detected.block.size)
    assert pixels is not None, "a frame that was read before"
    if seen.bend is not None:
        pixels = straighten(pixels, seen.bend)
    ground = cv2.warpPerspective(
        background.levels,
        seen.pose,
        detected.block.size,
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(0, 0, 0, 255),
    )
    shadow = background.shadows.direction
    if shadow is not None:
        turned = np.linalg.solve(seen.pose[:2, :2], np.array(shadow))
        turned /= np.hypot(*turned)
        shadow = (float(turned[0]), float(turned[1]))
    return Canvas(pixels.copy(), np.asarray(ground), 1 / float(np.mean(detected.block.metres_per_px)), shadow)


def _stock(detected: Detected, numbers: Sequence[int], glimpses: Sequence[Glimpse], reader: Reader) -> Stock:
    """Cut out the vehicles of the sampled frames that move and are alone."""
    donors: list[Donor] = []
    axes, paint = [np.zeros((0, 2))], [np.zeros(0, object)]
    most = -(-_MOST_DONORS // len(numbers))
    for n in numbers:
        found, glimpse = detected.frames[n].vehicles, glimpses[n]
        canvas = _canvas(detected, n, reader)
        rows = lone(glimpse, canvas.px_per_m)
        rows = rows[found.flags[rows] == 0][:most]
        made = [cut(canvas, box) for box in glimpse.boxes[rows]]
        whole = rows[[donor is not None for donor in made]] if len(rows) else rows
        donors += [donor for donor in made if donor is not None]
        axes.append(mapped(glimpse.boxes[whole], glimpse.pose)[:, 2:4])
        paint.append(paint_of(found.red[whole], found.green[whole], found.blue[whole]).astype(object))
    return Stock(donors, np.concatenate(axes), np.concatenate(paint))


def _painted(canvas: Canvas, glimpse: Glimpse, injections: Injections, donors: Sequence[Donor]) -> NDArray[np.bool_]:
    """Paint into *canvas*; return which of the injections (k,) could be painted."""
    others = np.zeros(canvas.pixels.shape[:2], np.uint8)
    for corners in corners_of(glimpse.boxes[~injections.replaced]):
        cv2.fillConvexPoly(others, np.rint(corners).astype(np.int32), 1)
    for box in glimpse.boxes[injections.replaced]:
        erase(canvas, box, others > 0, _ERASED_M * canvas.px_per_m)
    return np.array(
        [paint(canvas, box, donors[d]) for box, d in zip(injections.boxes, injections.donor, strict=True)], np.bool_
    )
