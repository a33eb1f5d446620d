"""Step ``track``: the detections of one sequence become matches, trajectories and track points."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from vtrack_batch.errors import ConfigError
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.model import homography
from vtrack_batch.model.views import Views
from vtrack_batch.model.zones import excluded
from vtrack_batch.pipeline.parts import Context, matrices_of, read, write
from vtrack_batch.pipeline.plan import Piece
from vtrack_batch.pipeline.revise import track_revised
from vtrack_batch.pipeline.tables import load_map
from vtrack_batch.storage.output import Part
from vtrack_batch.tracking.track import Tracks, track
from vtrack_batch.traffic.zones import parse_zones


def track_sequence(piece: Piece, context: Context) -> None:
    """Join the tables of the sequence's units, track, and write all tables of the sequence."""
    parts = [context.part(need) for need in piece.needs]
    seen = {name: read(parts, name) for name in ("frames", "registrations", "references", "detections")}
    crs = one_crs(seen["references"]["crs"].dropna())
    views = make_views(piece.name, seen)
    tracks, seen["detections"] = _track(seen["detections"], views, context, crs)
    used = int((seen["frames"]["status"].astype(str) == "used").sum())
    about = {"crs": crs, "frames_used": used, "frames_lost": len(seen["frames"]) - used}
    with context.new_part(piece, about) as folder:
        made = {
            "matches": tracks.matches,
            "track_points": tracks.track_points,
            "trajectories": tracks.trajectories,
            "quarantine": read(parts, "quarantine"),
        }
        write(folder, {**seen, **made}, crs)


def one_crs(named: Iterable[str]) -> str | None:
    """Return the one CRS that is *named*, None (local metres) where none is; coordinates of several do not mix."""
    known = sorted({str(crs) for crs in named})
    if len(known) > 1:
        raise ConfigError(
            f"the frames carry georeferences in several CRS ({', '.join(known)}): "
            "set georeference.crs to one of them, into which all are then brought"
        )
    return known[0] if known else None


def make_views(sequence: str, seen: dict[str, pd.DataFrame]) -> Views:
    """Return the clock and the ground footprint of every accepted frame of the sequence."""
    posed = seen["registrations"].loc[seen["registrations"]["accepted"]]
    frames = seen["frames"].merge(posed.drop(columns="accepted"), on="frame_id")
    frames = frames.merge(seen["references"], on="reference_frame_id", suffixes=("", "_reference"))
    frames = frames.sort_values("t_utc", ignore_index=True)
    to_ground = matrices_of("g", frames) @ matrices_of("h", frames)
    sizes = frames[["width_px", "height_px"]].to_numpy(int)
    corners_m = np.array(
        [homography.apply(h, homography.corners(*size)) for h, size in zip(to_ground, sizes.tolist(), strict=True)]
    )
    return Views(
        sequence,
        frames["t_utc"].dt.tz_localize(None).to_numpy("datetime64[us]"),
        corners_m.reshape(-1, 4, 2),
        np.hypot(frames["residual_m"].to_numpy(float), np.nan_to_num(frames["residual_m_reference"].to_numpy(float))),
    )


def views_of(part: Part, sequence: str) -> Views:
    """Return the views of a tracked sequence from its part."""
    return make_views(sequence, {name: read([part], name) for name in ("frames", "registrations", "references")})


def _track(detections: pd.DataFrame, views: Views, context: Context, crs: str | None) -> tuple[Tracks, pd.DataFrame]:
    """Return the tracks, and the detections as the tracks revised them."""
    survey = context.survey
    inside = np.zeros(len(detections), bool)
    if context.zones_text is not None:
        zones = parse_zones(context.zones_text, crs=crs, source=str(survey.zones))
        inside = excluded(zones, detections["x_m"].to_numpy(), detections["y_m"].to_numpy())
    matching: MatchingParams = survey.matching.model_copy(update={"model": survey.model_path})
    flow_map = load_map(survey.resolve(survey.flow_map) if survey.flow_map else None)

    def tracked(rows: pd.DataFrame, taught: FlowMap | None = None) -> Tracks:
        return track(
            rows,
            views={views.sequence: views},
            method=matching.method,
            flow_map=taught if flow_map is None and survey.tracking.link.self_taught else flow_map,
            matching=matching,
            params=survey.tracking,
        )

    tracks, revised = track_revised(detections[~inside].reset_index(drop=True), views, tracked, survey.revision)
    return tracks, pd.concat([revised, detections[inside]], ignore_index=True) if inside.any() else revised
