"""What ``vtrack-batch check`` finds out: archive, times, zones and a sample of frames, without processing anything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.read import read_bytes
from vtrack_batch.archive.sequences import shares_instant, split_sequences
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import UnusableFrame, VtrackError
from vtrack_batch.pipeline.ground import fix_ground
from vtrack_batch.pipeline.index import scan_archive
from vtrack_batch.pipeline.plan import FrameRef
from vtrack_batch.pipeline.run import read_zones_text
from vtrack_batch.traffic.zones import parse_zones

SAMPLE_FRAMES = 12


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
        lines = [f"{name.replace('_', ' ')}: {value}" for name, value in self.facts.items()]
        return "\n".join(
            [*lines, *(f"problem: {problem}" for problem in self.problems)]
            + ([] if self.problems else ["no problems found"])
        )


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
        "median_interval_s": _median_interval_s(files),
        "megabytes": round(float(files["size_bytes"].sum()) / 1e6, 1),
    }
    if files.empty:
        return Check(facts, (*problems, "no frame can be used"), 65)
    sizes, refused = _decode_sample(survey, files)
    facts["sizes_px"] = sorted({f"{width} x {height}" for width, height in sizes})
    problems += refused
    facts["ground"] = _ground(survey, files.iloc[0], sizes, problems)
    apart = facts["sequences"] > 1 and facts["ground"] and facts["ground"]["method"] in ("scale", "control_points")
    if apart and survey.georeference.reference_frame is None:
        facts["note"] = (
            f"each of the {facts['sequences']} sequences is laid on its own first frame; if they show one place, set "
            "georeference.reference_frame to one frame, so that coordinates and zones mean the same in all"
        )
    facts["zones"] = _zones(survey, facts["ground"])
    return Check(facts, tuple(problems), 65 if not sizes else 78 if facts["ground"] is None else 0)


def _median_interval_s(files: pd.DataFrame) -> float | None:
    gaps = files.groupby("sequence")["t_utc"].diff().dt.total_seconds().dropna()
    return round(float(gaps.median()), 3) if len(gaps) else None


def _decode_sample(survey: Survey, files: pd.DataFrame) -> tuple[list[tuple[int, int]], list[str]]:
    chosen = np.unique(np.linspace(0, len(files) - 1, min(SAMPLE_FRAMES, len(files))).round().astype(int))
    sizes, refused = [], []
    for path in files["path"].iloc[chosen]:
        try:
            data = read_bytes(survey.resolve(survey.archive.root), path)
            frame = decode(data, max_pixels=survey.archive.max_pixels)
            sizes.append((frame.width_px, frame.height_px))
        except UnusableFrame as problem:
            refused.append(f"{path}: {problem}")
    return sizes, refused


def _ground(
    survey: Survey, first: pd.Series, sizes: list[tuple[int, int]], problems: list[str]
) -> dict[str, Any] | None:
    if not sizes:
        return None
    root = survey.resolve(survey.archive.root)
    ref = FrameRef("", str(first["path"]), np.datetime64(0, "us"), "")
    try:
        fix = fix_ground(survey, root, ref, read_bytes(root, ref.path), *sizes[0])
    except VtrackError as problem:
        problems.append(f"ground: {problem}")
        return None
    return {
        "method": fix.method,
        "crs": fix.crs,
        "gsd_m": [round(gsd, 4) for gsd in fix.gsd_m],
        "residual_m": fix.residual_m,
    }


def _zones(survey: Survey, ground: Mapping[str, Any] | None) -> str:
    text = read_zones_text(survey)
    if text is None:
        return "none given: they will be proposed from the trajectories"
    zones = parse_zones(text, crs=ground["crs"] if ground else None, source=str(survey.zones))
    roles = pd.Series([zone.role for zone in zones], dtype=object).value_counts().sort_index()
    return ", ".join(f"{count} {role}" for role, count in roles.items())
