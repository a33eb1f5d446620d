"""Step ``detect``: one unit from encoded frames to detections in metres; each frame is read, used and let go."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.background.learn import Background, learn_background
from vtrack_batch.background.stacks import Sample
from vtrack_batch.completeness.table import INJECTIONS
from vtrack_batch.config.survey import Survey
from vtrack_batch.detection.again import seen_again
from vtrack_batch.detection.candidates import Candidates, find_candidates
from vtrack_batch.detection.examples import Examples
from vtrack_batch.detection.ground import measure_on_ground
from vtrack_batch.detection.lanes import Lanes, learn_lanes
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import flag_outside, learn_place, select
from vtrack_batch.detection.standing import find_standing, moving_boxes, with_standing
from vtrack_batch.errors import UnusableFrame
from vtrack_batch.georeference.ortho import orthorectify
from vtrack_batch.model import homography
from vtrack_batch.model.ground_grid import GroundGrid
from vtrack_batch.model.homography import Array
from vtrack_batch.model.ids import detection_id
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.block import Block
from vtrack_batch.pipeline.blocks import find_blocks
from vtrack_batch.pipeline.ground import mosaic_gsd_m
from vtrack_batch.pipeline.inject import Detected, Seen, inject
from vtrack_batch.pipeline.laying import Laid, References, lay_samples
from vtrack_batch.pipeline.parts import Context, write
from vtrack_batch.pipeline.plan import FrameRef, Piece
from vtrack_batch.pipeline.reading import FrameLog, Reader
from vtrack_batch.pipeline.samples import sample_store, seconds
from vtrack_batch.pipeline.unit_tables import unit_tables
from vtrack_batch.registration.alignment import Registration, register
from vtrack_batch.registration.bending import Bend
from vtrack_batch.registration.reference import prepare_reference
from vtrack_batch.storage.geotiff import merge_geotiffs, write_geotiff
from vtrack_batch.storage.parquet import empty_frame, write_table


def detect_unit(piece: Piece, context: Context) -> None:
    """Read the unit's frames; write its tables and its ground picture."""
    unit = piece.unit
    assert unit is not None
    log = FrameLog(unit)
    log.refuse_repeats()
    archive = context.survey.archive
    reader = Reader(context.archive, archive.max_pixels, log, context.take).by_fields(archive.interlaced)
    about: dict[str, Any] = {"interlaced": reader.one_field}
    with context.new_part(piece, about) as folder:
        done = list[Done]()
        for block in find_blocks(unit, reader, context):
            done.append(_detect_block(block, reader, context, folder, done[0].block if done else block))
        _join_pictures(folder, done)
        if context.survey.completeness.injections_per_unit and done:
            painted = pd.concat([of.injections for of in done], ignore_index=True)
            write_table(folder / f"{INJECTIONS.name}.parquet", INJECTIONS, painted)
        tables = unit_tables(log, [(of.block, of.detections) for of in done])
        write(folder, tables, done[0].block.fix.crs if done else None)
        about |= log.counts()


@dataclass(frozen=True)
class Done:
    """What became of a block: its detections, what came back of painted vehicles, and the picture of its ground."""

    block: Block
    detections: pd.DataFrame
    injections: pd.DataFrame | None
    ground: Path


def _detect_block(block: Block, reader: Reader, context: Context, folder: Path, first: Block) -> Done:
    """Detect in one block; the pixels of the *first* say how large those of all ground pictures are."""
    survey = context.survey
    ground, references = _first_pass(block, reader, survey, folder)
    detected = _second_pass(block, ground, references, reader, survey)
    picture = _write_ground(folder, block, ground.background, mosaic_gsd_m(survey, first.fix.gsd_m))
    wanted = survey.completeness.injections_per_unit > 0
    painted = _injections(folder, detected, references, reader, survey) if wanted else None
    return Done(block, _detections(detected), painted, picture)


def _join_pictures(folder: Path, done: list[Done]) -> None:
    """Make one picture of the ground of all blocks."""
    pictures = [of.ground for of in done]
    if len(pictures) > 1:
        merge_geotiffs(pictures, folder / "ground.tif")
        for picture in pictures:
            picture.unlink()
    elif pictures:
        pictures[0].rename(folder / "ground.tif")


@dataclass(frozen=True)
class Ground:
    """The ground of a block without vehicles, and which way they lie on it; None = not asked."""

    background: Background
    lanes: Lanes | None


def _first_pass(block: Block, reader: Reader, survey: Survey, folder: Path) -> tuple[Ground, References]:
    """Learn the ground from frames spread over the block and its halo, and which patches hold still.

    Samples that memory should not hold wait in a file in *folder* without a name.
    """
    reference = block.hand_over()
    rough = prepare_reference(reference, params=survey.registration)
    chosen = _spread(block, reader, survey.background.samples - 1)
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
        lanes = _lanes(timed, background, block, survey.detection)
    return Ground(background, lanes), references


def _lanes(samples: Sequence[Sample], background: Background, block: Block, params: DetectionParams) -> Lanes | None:
    """Let vehicles in some of the *samples* tell which way they lie where."""
    if not params.lane_frames:
        return None
    most = min(params.lane_frames, len(samples))
    chosen = [samples[i] for i in np.unique(np.linspace(0, len(samples) - 1, most).round().astype(int))]
    scale, poses = block.metres_per_px, [sample.frame_to_reference for sample in chosen]
    found = [
        find_candidates(sample.pixels[:], pose, background, metres_per_px=scale, params=params.alone())
        for sample, pose in zip(chosen, poses, strict=True)
    ]
    return learn_lanes(found, poses, background.levels.shape, metres_per_px=scale, params=params)


def _spread(block: Block, reader: Reader, count: int) -> list[FrameRef]:
    """Return up to *count* frames of the block and its halo, evenly spread in order of time, without the reference.

    A camera that is frozen repeats itself: of frames with one content the first alone has a say. Frames known to be of
    another size are another block's.
    """
    pool = sorted((*block.unit.frames, *block.unit.halo), key=lambda ref: (ref.t_utc, ref.frame_id))
    pool = [ref for ref in pool if reader.log.size.get(ref.frame_id, block.size) == block.size]
    first = {ref.sha256: ref for ref in reversed(pool)}
    pool = [ref for ref in pool if ref is first[ref.sha256] and ref.sha256 != block.ref.sha256]
    chosen: NDArray[np.int64] | list[int] = (
        np.unique(np.linspace(0, len(pool) - 1, min(count, len(pool))).round().astype(int)) if pool else []
    )
    return [pool[i] for i in chosen]


def _second_pass(block: Block, ground: Ground, references: References, reader: Reader, survey: Survey) -> Detected:
    """Register every frame, find candidates, tell which of them fit the block's place model."""
    background, lanes = ground.background, ground.lanes
    params, scale = survey.detection, block.metres_per_px
    examples = Examples.of(len(block.unit.frames))
    seen: list[tuple[FrameRef, Array, Bend | None, Candidates, Candidates]] = []
    for ref, laid, every in _candidates(block, ground, references, reader, survey):
        faint = every.score < params.weak_score
        found = every.take(~faint)
        examples.add(len(seen), laid.pixels, found, scale, params)
        seen.append((ref, laid.registration.frame_to_reference, laid.bend, found, every.take(faint)))
        del laid  # a large frame, before the next one is read
    if not seen:
        return Detected(block, background, lanes, None, [])
    refs, poses, bends, candidates, faints = zip(*seen, strict=True)
    times_s = np.array([(ref.t_utc - refs[0].t_utc) / np.timedelta64(1, "s") for ref in refs])
    place = learn_place(candidates, poses, times_s, metres_per_px=scale, params=params, ground=background.levels)
    driven = moving_boxes(candidates, poses, place)
    standing = find_standing(background, examples, place, driven, metres_per_px=scale, params=params)
    chosen = [
        select(f, p, place, frame=i, params=params) for i, (f, p) in enumerate(zip(candidates, poses, strict=True))
    ]
    taken = [found.take(rows) for found, rows in zip(candidates, chosen, strict=True)]
    due = seen_again(taken, faints, poses, times_s, place, params=params)
    frames = []
    for i, found in enumerate(candidates):
        again = faints[i].take(due[i])
        rows = np.concatenate([chosen[i], np.ones(len(again), np.bool_)])
        kept = with_standing(found.joined(again), rows, standing, poses[i], block.size, scale)
        frames.append(Seen(refs[i], poses[i], bends[i], flag_outside(kept, poses[i], place)))
    return Detected(block, background, lanes, place, frames)


def _detections(detected: Detected) -> pd.DataFrame:
    """Return the detections of a block, frame by frame; ids rank by place, row then column."""
    if not detected.frames:
        return empty_frame(TABLES["detections"])
    to_ground = detected.block.fix.reference_to_ground
    tables = [_measured(seen, to_ground) for seen in detected.frames]
    counts = np.array([len(table) for table in tables])
    found, frame = pd.concat(tables, ignore_index=True), np.repeat(np.arange(len(tables)), counts)
    order = np.lexsort((found["col_px"], found["row_px"], frame))
    rank = np.arange(len(frame)) - np.repeat(np.cumsum(counts) - counts, counts)
    refs = [seen.ref for seen in detected.frames]
    ids = [ref.frame_id for ref in refs]
    return (
        found.take(order)
        .reset_index(drop=True)
        .assign(
            detection_id=[detection_id(ids[of], at) for of, at in zip(frame.tolist(), rank.tolist(), strict=True)],
            frame_id=np.array(ids, object)[frame],
            sequence=detected.block.unit.sequence,
            t_utc=pd.DatetimeIndex(np.array([ref.t_utc for ref in refs]), tz="UTC")[frame],
            vx_mps=np.nan,
            vy_mps=np.nan,
        )
    )


def _measured(seen: Seen, to_ground: Array) -> pd.DataFrame:
    """Return one frame's measurements, places in the frame as it was taken."""
    found, place = measure_on_ground(seen.vehicles, to_ground @ seen.pose), ["col_px", "row_px"]
    if seen.bend is not None:
        found[place] = seen.bend.to_frame(found[place].to_numpy())
    return found


def _candidates(
    block: Block, ground: Ground, references: References, reader: Reader, survey: Survey
) -> Iterator[tuple[FrameRef, Laid, Candidates]]:
    for ref in block.unit.frames:
        pixels = reader.pixels(ref, block.size)
        if pixels is None:
            continue
        laid = references.lay(pixels, survey.registration)
        pose = reader.log.pose[ref.frame_id] = laid.registration
        if not pose.accepted:
            reason = pose.reason or "not_registered"
            reader.log.refuse(ref, UnusableFrame(reason, f"residual {pose.residual_px:.2f} px, {pose.inliers} inliers"))
            continue
        at, scale = pose.frame_to_reference, block.metres_per_px
        tried = ground.lanes.tried_in(at) if ground.lanes else None
        found = find_candidates(
            laid.pixels, at, ground.background, metres_per_px=scale, params=survey.detection, tried=tried
        )
        yield ref, laid, found


def _injections(
    folder: Path, detected: Detected, references: References, reader: Reader, survey: Survey
) -> pd.DataFrame:
    """Paint known vehicles into the background's samples, count what comes back; the halo's are samples as they are."""
    sampled = [detected.block.ref, *_spread(detected.block, reader, survey.background.samples - 1)]
    inside = {ref.frame_id for ref in detected.block.unit.frames}

    def halo() -> Iterator[Sample]:
        for ref in sampled:
            pixels = reader.pixels(ref, detected.block.size) if ref.frame_id not in inside else None
            laid = references.lay(pixels, survey.registration) if pixels is not None else None
            if laid is not None and laid.registration.accepted:
                yield Sample(laid.pixels, laid.registration.frame_to_reference, seconds(ref))

    return inject(detected, sampled, halo, reader, survey, folder)


def _write_ground(folder: Path, block: Block, background: Background, gsd_m: float) -> Path:
    """Write the block's background as GeoTIFF with pixels of *gsd_m*; return where."""
    corners_m = homography.apply(block.fix.reference_to_ground, homography.corners(*block.size))
    grid = GroundGrid.covering(corners_m, gsd_m, crs=block.fix.crs)
    pixels, valid = orthorectify(background.pixels, block.fix.reference_to_ground, grid, seen=background.seen)
    path = folder / f"ground-{block.ref.frame_id}.tif"
    write_geotiff(path, pixels, valid, grid)
    return path
