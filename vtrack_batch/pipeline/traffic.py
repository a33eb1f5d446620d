"""Step ``traffic``: the trajectories of one local date become the measures that planners ask for."""

from __future__ import annotations

import json

from vtrack_batch.pipeline.completeness import with_completeness
from vtrack_batch.pipeline.parts import Context, read, write
from vtrack_batch.pipeline.plan import Piece
from vtrack_batch.pipeline.track import one_crs, views_of
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.propose import propose_zones
from vtrack_batch.traffic.zones import parse_zones, zones_to_geojson


def measure_date(piece: Piece, context: Context) -> None:
    """Measure crossings, OD pairs, turns, speeds, flows, stops and coverage over all sequences of a date."""
    parts = [context.part(need) for need in piece.needs]
    crs = one_crs(part.about["crs"] for part in parts if part.about["crs"])
    trajectories, track_points = read(parts, "trajectories"), read(parts, "track_points")
    views = {need.name: views_of(part, need.name) for need, part in zip(piece.needs, parts, strict=True)}
    survey = context.survey
    if context.zones_text is not None:
        zones = parse_zones(context.zones_text, crs=crs, source=str(survey.zones))
    else:
        zones = propose_zones(trajectories, track_points, views, params=survey.traffic)
    tables = measure(trajectories, track_points, zones, views, time_zone=survey.survey.time_zone, params=survey.traffic)
    tables["coverage"] = with_completeness(tables["coverage"], piece.needs, zones, context)
    proposed = context.zones_text is None
    with context.new_part(piece, {"crs": crs, "proposed": proposed}) as folder:
        write(folder, tables, crs)
        text = json.dumps(zones_to_geojson(zones, crs), indent=1, sort_keys=True, ensure_ascii=False)
        (folder / "zones.geojson").write_text(text + "\n", encoding="utf-8")
