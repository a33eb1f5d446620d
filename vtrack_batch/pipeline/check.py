"""What ``vtrack-batch check`` finds out: archive, times, zones and a sample of frames, without processing anything."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import shapely

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.fields import are_interlaced, turns
from vtrack_batch.archive.read import read_bytes
from vtrack_batch.archive.sequences import median_interval_s, shares_instant, split_sequences
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import UnusableFrame, VtrackError
from vtrack_batch.georeference.fix import GroundFix
from vtrack_batch.model import homography
from vtrack_batch.model.zones import TEMPLATE_NAME, Zone
from vtrack_batch.pipeline.clocks import disagreements
from vtrack_batch.pipeline.ground import fix_ground
from vtrack_batch.pipeline.index import scan_archive
from vtrack_batch.pipeline.plan import FrameRef
from vtrack_batch.pipeline.prepare import read_zones_text
from vtrack_batch.traffic.zones import doubtful_properties, parse_zones

SAMPLE_FRAMES = 12
SCALED = ("scale", "control_points")  # grounds that hold for one reference frame alone
CAR_M = 4.5
CAR_PX = (6.0, 90.0)  # length of a car in pixels for which detection was made


@dataclass(frozen=True)
class Check:
    """What was found; ``problems`` are what a run would stumble over."""

    facts: Mapping[str, Any]
    problems: tuple[str, ...]
    exit_code: int

    def as_dict(self) -> dict[str, Any]:
        """Return the findings for JSON."""
        return {**self.facts, "problems": list(self.problems)}

    def text(self) -> str:
        """Return the findings for people."""
        lines = [f"{name.replace('_', ' ')}: {_words(value)}" for name, value in self.facts.items()]
        return "\n".join(
            [*lines, *(f"problem: {problem}" for problem in self.problems)]
            + ([] if self.problems else ["no problems found"])
        )


def _words(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(inner)}" for name, inner in value.items() if inner is not None)
    if isinstance(value, list):
        return (", " if any(isinstance(part, str) for part in value) else " x ").join(map(str, value))
    return str(value)


def check_survey(survey: Survey) -> Check:
    """Scan the archive, decode a sample of its frames, find the ground and read the zones.

    Raises ``NoArchive`` or ``ConfigError`` where a run would end at once.
    """
    found = scan_archive(survey)
    files = split_sequences(found.files, max_gap_s=survey.archive.max_gap_s, time_zone=survey.survey.time_zone)
    problems = [f"{count} files: {reason}" for reason, count in found.quarantine["reason"].value_counts().items()]
    doubles = int(shares_instant(files).sum())
    if doubles:
        problems.append(f"{doubles} files share their time with another of the same platform: one of each will be used")
    facts: dict[str, Any] = {
        "archive": str(survey.resolve(survey.archive.root)),
        "frames": len(files),
        "times_from": found.source,
        "first": str(files["t_utc"].min()),
        "last": str(files["t_utc"].max()),
        "sequences": int(files["sequence"].nunique()),
        "median_interval_s": median_interval_s(files),
        "megabytes": round(float(files["size_bytes"].sum()) / 1e6, 1),
    }
    if files.empty:
        return Check(facts, (*problems, "no frame can be used"), 65)
    sample = _sample(files)
    sizes, refused, interlaced = _decode_sample(survey, sample)
    facts["sizes_px"] = sorted({f"{width} x {height}" for width, height in sizes})
    if interlaced:
        facts["interlaced"] = "yes: of two fields in each frame the upper one is used, see archive.interlaced"
    problems += [*refused, *disagreements(survey, sample)]
    fix = _ground(survey, files.iloc[0], sizes, problems)
    facts["ground"] = _told(fix, sizes[0]) if fix else None
    if fix and facts["sequences"] > 1 and fix.method in SCALED and survey.georeference.reference_frame is None:
        facts["note"] = (
            f"each of the {facts['sequences']} sequences is laid on its own first frame; if they show one place, set "
            "georeference.reference_frame to one frame, so that coordinates and zones mean the same in all"
        )
    zones = _zones(survey, fix)
    facts["zones"] = _counted(zones)
    if fix and sizes:
        problems += _doubts(zones, fix, sizes[0])
    return Check(facts, tuple(problems), 65 if not sizes else 78 if fix is None else 0)


def _sample(files: pd.DataFrame) -> pd.DataFrame:
    return files.iloc[np.unique(np.linspace(0, len(files) - 1, min(SAMPLE_FRAMES, len(files))).round().astype(int))]


def _decode_sample(survey: Survey, sample: pd.DataFrame) -> tuple[list[tuple[int, int]], list[str], bool]:
    sizes, refused, found = [], [], []
    for path in sample["path"]:
        try:
            data = read_bytes(survey.resolve(survey.archive.root), path)
            frame = decode(data, max_pixels=survey.archive.max_pixels)
            sizes.append((frame.width_px, frame.height_px))
            found.append(turns(frame.pixels))
        except UnusableFrame as problem:
            refused.append(f"{path}: {problem}")
    told = survey.archive.interlaced
    return sizes, refused, are_interlaced(found) if told is None else told


def _ground(survey: Survey, first: pd.Series, sizes: list[tuple[int, int]], problems: list[str]) -> GroundFix | None:
    if not sizes:
        return None
    root = survey.resolve(survey.archive.root)
    ref = FrameRef(str(first["path"]), np.datetime64(0, "us"), "")
    try:
        return fix_ground(survey, root, ref, read_bytes(root, ref.path), *sizes[0])
    except VtrackError as problem:
        problems.append(f"ground: {problem}")
        return None


def _told(fix: GroundFix, size_px: tuple[int, int]) -> dict[str, Any]:
    gsd_m = [round(gsd, 4) for gsd in fix.gsd_m]
    told = {} if not fix.left_out else {"control_points_left_out": [f"number {n + 1}" for n in fix.left_out]}
    return told | {
        "from": fix.method,
        "crs": fix.crs or "local metres",
        "gsd_m": gsd_m,
        "frame_m": [round(gsd * size, 1) for gsd, size in zip(gsd_m, size_px, strict=True)],
        "car_px": round(CAR_M / max(fix.gsd_m), 1),
        "residual_m": fix.residual_m,
    }


def _zones(survey: Survey, fix: GroundFix | None) -> list[Zone] | None:
    text = read_zones_text(survey)
    return None if text is None else parse_zones(text, crs=fix.crs if fix else None, source=str(survey.zones))


def _counted(zones: list[Zone] | None) -> str:
    if zones is None:
        return "none given: they will be proposed from the trajectories"
    roles = pd.Series([zone.role for zone in zones], dtype=object).value_counts().sort_index()
    return ", ".join(f"{count} {role}" for role, count in roles.items())


def _doubts(zones: list[Zone] | None, fix: GroundFix, size_px: tuple[int, int]) -> Iterator[str]:
    """Yield what reads well but can hardly be meant: the size of a pixel, zones out of view, the unedited template."""
    car_px = CAR_M / max(fix.gsd_m)
    if not CAR_PX[0] <= car_px <= CAR_PX[1]:
        yield (
            f"ground: at {max(fix.gsd_m):g} m a pixel a car is {car_px:.1f} px long; it can be found where it has "
            f"{CAR_PX[0]:g} to {CAR_PX[1]:g}: is georeference.gsd_m in metres?"
        )
    width, height = size_px
    corners = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    corners_m = homography.apply(fix.reference_to_ground, corners)
    view = shapely.Polygon(corners_m)
    yield from doubtful_properties(zones or [])
    for zone in zones or []:
        if zone.name == TEMPLATE_NAME:
            yield f"zone {zone.id}: is still that of the template; draw your own, see docs/how-to/draw-zones.md"
        elif not zone.geometry.intersects(view):
            x, y = shapely.get_coordinates(zone.geometry.centroid)[0]
            (left, bottom), (right, top) = corners_m.min(axis=0), corners_m.max(axis=0)
            yield (
                f"zone {zone.id}: lies at x {x:.0f}, y {y:.0f}, outside of the first frame "
                f"(x {left:.0f} to {right:.0f}, y {bottom:.0f} to {top:.0f}); "
                "nothing is counted there unless other frames see it"
            )
