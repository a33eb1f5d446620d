"""Step ``detect``: one unit from encoded frames to detections in metres; each frame is read, used and let go."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.background.learn import Background, learn_background
from vtrack_batch.background.stacks import Sample
from vtrack_batch.completeness.table import INJECTIONS
from vtrack_batch.config.survey import Survey
from vtrack_batch.detection.candidates import Candidates, find_candidates
from vtrack_batch.detection.examples import Examples
from vtrack_batch.detection.ground import measure_on_ground
from vtrack_batch.detection.place import flag_outside, learn_place, select
from vtrack_batch.detection.standing import find_standing, moving_boxes, with_standing
from vtrack_batch.errors import UnusableFrame
from vtrack_batch.georeference.ortho import orthorectify
from vtrack_batch.model import homography
from vtrack_batch.model.ground_grid import GroundGrid
from vtrack_batch.model.homography import Array
from vtrack_batch.model.ids import detection_id
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.block import Block, find_block
from vtrack_batch.pipeline.ground import mosaic_gsd_m
from vtrack_batch.pipeline.inject import Detected, Seen, inject
from vtrack_batch.pipeline.laying import Laid, References, lay_samples
from vtrack_batch.pipeline.parts import Context, matrix_columns, write
from vtrack_batch.pipeline.plan import FrameRef, Piece, Unit
from vtrack_batch.pipeline.reading import FrameLog, Reader
from vtrack_batch.pipeline.samples import sample_store, seconds
from vtrack_batch.registration.alignment import Registration, register
from vtrack_batch.registration.bending import Bend
from vtrack_batch.registration.reference import prepare_reference
from vtrack_batch.storage.geotiff import write_geotiff
from vtrack_batch.storage.parquet import empty_frame, write_table


def detect_unit(piece: Piece, context: Context) -> None:
    """Read the unit's frames; write its tables and its ground picture."""
    unit = piece.unit
    assert unit is not None
    log = FrameLog(unit)
    log.refuse_repeats()
    reader = Reader(context.archive, context.survey.archive.max_pixels, log, context.take)
    about: dict[str, Any] = {}
    with context.new_part(piece, about) as folder:
        block = find_block(unit, reader, context)
        detections = empty_frame(TABLES["detections"])
        if block is not None:
            background, references = _first_pass(unit, block, reader, context.survey, folder)
            detected = _second_pass(unit, block, background, references, reader, context.survey)
            detections = _detections(unit, detected)
            _write_ground(folder, block, background, context.survey)
            if context.survey.completeness.injections_per_unit:
                _write_injections(folder, unit, detected, references, reader, context.survey)
        _write(folder, log, block, detections)
        about |= log.counts()


def _first_pass(
    unit: Unit, block: Block, reader: Reader, survey: Survey, folder: Path
) -> tuple[Background, References]:
    """Learn the background from frames spread over the unit and its halo, and which patches hold still.

    Samples that memory should not hold wait in a file in *folder* without a name.
    """
    reference = block.hand_over()
    rough = prepare_reference(reference, params=survey.registration)
    chosen = _spread(unit, block.ref, survey.background.samples - 1)
    with sample_store(folder, (len(chosen) + 1) * reference.nbytes) as keep:
        kept, laid, taken_s = [keep(reference)], list[Registration](), [seconds(block.ref)]
        del reference
        for ref in chosen:
            pixels = reader.pixels(ref, block.size)
            pose = register(pixels, rough, params=survey.registration) if pixels is not None else None
            if pixels is not None and pose is not None and pose.accepted:
                kept.append(keep(pixels))
                laid.append(pose)
                taken_s.append(seconds(ref))
        samples, references = lay_samples(kept, laid, rough, keep=keep, params=survey.registration)
        timed = [replace(sample, taken_s=when) for sample, when in zip(samples, taken_s, strict=True)]
        background = learn_background(
            timed, params=survey.background, metres_per_px=float(np.mean(block.metres_per_px))
        )
    return background, references


def _spread(unit: Unit, reference: FrameRef, count: int) -> list[FrameRef]:
    """Return up to *count* frames of the unit and its halo, evenly spread in order of time, without the reference.

    A camera that is frozen repeats itself: of frames with one content the first alone has a say.
    """
    pool = sorted((*unit.frames, *unit.halo), key=lambda ref: (ref.t_utc, ref.frame_id))
    first = {ref.sha256: ref for ref in reversed(pool)}
    pool = [ref for ref in pool if ref is first[ref.sha256] and ref.sha256 != reference.sha256]
    chosen: NDArray[np.int64] | list[int] = (
        np.unique(np.linspace(0, len(pool) - 1, min(count, len(pool))).round().astype(int)) if pool else []
    )
    return [pool[i] for i in chosen]


def _second_pass(
    unit: Unit, block: Block, background: Background, references: References, reader: Reader, survey: Survey
) -> Detected:
    """Register every frame, find candidates, tell which of them fit the block's place model."""
    examples = Examples.of(len(unit.frames))
    seen: list[tuple[FrameRef, Array, Bend | None, Candidates]] = []
    for ref, laid, found in _candidates(unit, block, background, references, reader, survey):
        examples.add(len(seen), laid.pixels, found, block.metres_per_px, survey.detection)
        seen.append((ref, laid.registration.frame_to_reference, laid.bend, found))
    if not seen:
        return Detected(block, background, None, [])
    refs, poses, _, candidates = zip(*seen, strict=True)
    times_s = np.array([(ref.t_utc - refs[0].t_utc) / np.timedelta64(1, "s") for ref in refs])
    place = learn_place(candidates, poses, times_s, metres_per_px=block.metres_per_px, params=survey.detection)
    driven = moving_boxes(candidates, poses, place)
    standing = find_standing(
        background, examples, place, driven, metres_per_px=block.metres_per_px, params=survey.detection
    )
    frames = []
    for index, (ref, pose, bend, found) in enumerate(seen):
        chosen = select(found, pose, place, frame=index, params=survey.detection)
        kept = with_standing(found, chosen, standing, pose, block.size, block.metres_per_px)
        frames.append(Seen(ref, pose, bend, flag_outside(kept, pose, place)))
    return Detected(block, background, place, frames)


def _detections(unit: Unit, detected: Detected) -> pd.DataFrame:
    """Return the detections of the unit."""
    to_ground = detected.block.fix.reference_to_ground
    tables = [
        _table(seen, unit.sequence, measure_on_ground(seen.vehicles, to_ground @ seen.pose)) for seen in detected.frames
    ]
    return pd.concat(tables, ignore_index=True) if tables else empty_frame(TABLES["detections"])


def _candidates(
    unit: Unit, block: Block, background: Background, references: References, reader: Reader, survey: Survey
) -> Iterator[tuple[FrameRef, Laid, Candidates]]:
    for ref in unit.frames:
        pixels = reader.pixels(ref, block.size)
        if pixels is None:
            continue
        laid = references.lay(pixels, survey.registration)
        pose = reader.log.pose[ref.frame_id] = laid.registration
        if not pose.accepted:
            reason = pose.reason or "not_registered"
            reader.log.refuse(ref, UnusableFrame(reason, f"residual {pose.residual_px:.2f} px, {pose.inliers} inliers"))
            continue
        found = find_candidates(
            laid.pixels, pose.frame_to_reference, background, metres_per_px=block.metres_per_px, params=survey.detection
        )
        yield ref, laid, found


def _write_injections(
    folder: Path, unit: Unit, detected: Detected, references: References, reader: Reader, survey: Survey
) -> None:
    """Paint known vehicles into the background's samples, count what comes back; the halo's are samples as they are."""
    sampled = [detected.block.ref, *_spread(unit, detected.block.ref, survey.background.samples - 1)]
    inside = {ref.frame_id for ref in unit.frames}

    def halo() -> Iterator[Sample]:
        for ref in sampled:
            pixels = reader.pixels(ref, detected.block.size) if ref.frame_id not in inside else None
            laid = references.lay(pixels, survey.registration) if pixels is not None else None
            if laid is not None and laid.registration.accepted:
                yield Sample(laid.pixels, laid.registration.frame_to_reference, seconds(ref))

    rows = inject(detected, sampled, halo, reader, survey, folder)
    write_table(folder / f"{INJECTIONS.name}.parquet", INJECTIONS, rows)


# writing --------------------------------------------------------------------------------------------------------------


def _table(seen: Seen, sequence: str, found: pd.DataFrame) -> pd.DataFrame:
    """Complete one frame's measurements to rows of ``detections``; ids rank by place, row then column."""
    ref, place = seen.ref, ["col_px", "row_px"]
    if seen.bend is not None:
        found[place] = seen.bend.to_frame(found[place].to_numpy())
    found = found.sort_values(["row_px", "col_px"], kind="stable", ignore_index=True)
    return found.assign(
        detection_id=[detection_id(ref.frame_id, rank) for rank in range(len(found))],
        frame_id=ref.frame_id,
        sequence=sequence,
        t_utc=pd.Timestamp(ref.t_utc, tz="UTC"),
        vx_mps=np.nan,
        vy_mps=np.nan,
    )


def _write(folder: Path, log: FrameLog, block: Block | None, detections: pd.DataFrame) -> None:
    tables = {
        "frames": _frames(log),
        "registrations": _registrations(log, block),
        "references": _references(block),
        "detections": detections,
        "quarantine": _quarantine(log),
    }
    write(folder, tables, block.fix.crs if block else None)


def _frames(log: FrameLog) -> pd.DataFrame:
    refs = log.unit.frames
    sizes = [log.size.get(ref.frame_id, (None, None)) for ref in refs]
    problems = [log.refused.get(ref.frame_id) for ref in refs]
    return pd.DataFrame(
        {
            "frame_id": [ref.frame_id for ref in refs],
            "sequence": log.unit.sequence,
            "path": [ref.path for ref in refs],
            "t_utc": pd.DatetimeIndex(np.array([ref.t_utc for ref in refs]), tz="UTC"),
            "width_px": pd.array([width for width, _ in sizes], dtype="Int32"),
            "height_px": pd.array([height for _, height in sizes], dtype="Int32"),
            "sha256": [ref.sha256 for ref in refs],
            "status": ["quarantined" if problem else "used" for problem in problems],
            "reason": [problem.reason if problem else None for problem in problems],
        }
    )


def _registrations(log: FrameLog, block: Block | None) -> pd.DataFrame:
    done = [(ref, log.pose[ref.frame_id]) for ref in log.unit.frames if ref.frame_id in log.pose]
    if block is None or not done:
        return empty_frame(TABLES["registrations"])
    poses = [pose for _, pose in done]
    residual_px = np.array([pose.residual_px if np.isfinite(pose.residual_px) else np.nan for pose in poses])
    return pd.DataFrame(
        {
            "frame_id": [ref.frame_id for ref, _ in done],
            "reference_frame_id": block.ref.frame_id,
            **matrix_columns("h", np.array([pose.frame_to_reference for pose in poses])),
            "inliers": np.array([pose.inliers for pose in poses], "int32"),
            "residual_px": residual_px,
            "residual_m": residual_px * float(np.mean(block.metres_per_px)),
            "accepted": [pose.accepted for pose in poses],
        }
    )


def _references(block: Block | None) -> pd.DataFrame:
    if block is None:
        return empty_frame(TABLES["references"])
    return pd.DataFrame(
        {
            "reference_frame_id": [block.ref.frame_id],
            **matrix_columns("g", block.fix.reference_to_ground[None]),
            "method": [block.fix.method],
            "residual_m": [np.nan if block.fix.residual_m is None else block.fix.residual_m],
            "crs": [block.fix.crs],
        }
    )


def _quarantine(log: FrameLog) -> pd.DataFrame:
    own = [(ref, log.refused[ref.frame_id]) for ref in log.unit.frames if ref.frame_id in log.refused]
    return pd.DataFrame(
        {
            "path": [ref.path for ref, _ in own],
            "reason": [problem.reason for _, problem in own],
            "detail": [problem.detail or None for _, problem in own],
        },
        dtype=object,
    )


def _write_ground(folder: Path, block: Block, background: Background, survey: Survey) -> None:
    """Write the block's background as GeoTIFF at the set ground sampling distance."""
    corners_m = homography.apply(block.fix.reference_to_ground, homography.corners(*block.size))
    gsd_m = mosaic_gsd_m(survey, block.fix.gsd_m)
    grid = GroundGrid.covering(corners_m, gsd_m, crs=block.fix.crs)
    pixels, valid = orthorectify(background.pixels, block.fix.reference_to_ground, grid, seen=background.seen)
    write_geotiff(folder / "ground.tif", pixels, valid, grid)
