"""The table of what was painted and found, and of what was found without."""

from __future__ import annotations

from vtrack_batch.model.tables import Column, Table

INJECTIONS = Table(
    "injections",
    "Vehicles painted into copies of frames, and whether they were found; beside them those that were really found.",
    ("sighting_id",),
    (
        Column("sighting_id", "text", "-", "the frame and a number"),
        Column("t_utc", "time", "UTC", "when the frame was taken"),
        Column("x_m", "float64", "m", "ground coordinate: easting, or right in the local frame"),
        Column("y_m", "float64", "m", "ground coordinate: northing, or up in the local frame"),
        Column("painted", "bool", "-", "painted, not real"),
        Column("stands", "bool", "-", "in a place where a vehicle stood"),
        Column("stay", "text", "-", "painted: the stay, or the sighting itself where it moves; real: empty"),
        Column("paint", "category", "-", "dark, grey, light, coloured"),
        Column("found", "bool", "-", "whether the detector finds it"),
    ),
)
