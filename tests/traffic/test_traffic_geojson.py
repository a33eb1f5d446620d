"""Zones from GeoJSON: degrees, metres, and every mistake said at once."""

import json

import numpy as np
import pyproj
import pytest
from shapely.geometry import LineString, Polygon

from vtrack_batch.errors import ConfigError
from vtrack_batch.model.zones import Zone, excluded
from vtrack_batch.traffic.zones import parse_zones, zones_to_geojson

UTM = "EPSG:25832"


def _feature(role="zone", geometry=None, **properties):
    square = {"type": "Polygon", "coordinates": [[[0, 0], [30, 0], [30, 10], [0, 10], [0, 0]]]}
    return {"type": "Feature", "properties": {"role": role, **properties}, "geometry": geometry or square}


def _text(*features, **top):
    return json.dumps({"type": "FeatureCollection", "features": list(features), **top})


def _degrees(x, y):
    lon, lat = pyproj.Transformer.from_crs(UTM, "EPSG:4326", always_xy=True).transform(x, y)
    return [lon, lat]


def test_degrees_become_metres_of_the_survey():
    corners = [(500000, 5700000), (500080, 5700000), (500080, 5700020), (500000, 5700000)]
    ring = [_degrees(x, y) for x, y in corners]
    zone = parse_zones(
        _text(_feature(id="a", geometry={"type": "Polygon", "coordinates": [ring]})), crs=UTM, source="z"
    )[0]
    assert np.allclose(zone.geometry.exterior.coords, corners, atol=1e-3)


@pytest.mark.parametrize("name", ["EPSG:25832", "urn:ogc:def:crs:EPSG::25832"])
def test_crs_member_is_honoured(name):
    member = {"type": "name", "properties": {"name": name}}
    zone = parse_zones(_text(_feature(id="a"), crs=member), crs="EPSG:25832", source="z")[0]
    assert zone.geometry.bounds == pytest.approx((0, 0, 30, 10), abs=1e-6)


def test_local_metres_with_and_without_saying_so():
    for top in ({}, {"vtrack_coordinates": "local_m"}):
        zone = parse_zones(_text(_feature(id=7, name="Park", junction=3, width_m=4), **top), crs=None, source="z")[0]
        assert (zone.id, zone.name, zone.junction) == ("7", "Park", "3")
        assert zone.properties == {"width_m": 4}
        assert zone.geometry.bounds == (0, 0, 30, 10)


def test_degrees_without_a_crs_are_refused_with_advice():
    ring = [[8.40, 49.01], [8.401, 49.01], [8.401, 49.011], [8.40, 49.01]]
    text = _text(_feature(id="a", geometry={"type": "Polygon", "coordinates": [ring]}))
    with pytest.raises(ConfigError, match=r"zones\.json: the zones are in degrees.*georeference\.crs.*local_m"):
        parse_zones(text, crs=None, source="zones.json")


def test_metres_where_degrees_are_due_are_refused_with_advice():
    line = {"type": "LineString", "coordinates": [[500000, 5700000], [500010, 5700000]]}
    with pytest.raises(ConfigError, match=r"degrees.*500000.*crs"):
        parse_zones(_text(_feature("gate", line, id="a")), crs=UTM, source="z")


def test_all_problems_come_at_once_one_a_line():
    bow = {"type": "Polygon", "coordinates": [[[0, 0], [10, 10], [10, 0], [0, 10], [0, 0]]]}
    text = _text(
        _feature("zone", bow, id="bow"),
        _feature("zoone", id="typo"),
        _feature("gate", id="area-gate"),
        _feature("zone"),
        _feature("zone", id="twice"),
        _feature("zone", id="twice"),
        _feature("zone", {"type": "Polygon", "coordinates": []}, id="empty"),
        _feature("gate", {"type": "LineString", "coordinates": [[1, 1], [1, 1]]}, id="point"),
        _feature("zone", {"type": "MultiPolygon", "coordinates": []}, id="multi"),
        _feature("approach", id="armless"),
        _feature("zone", id="unknown"),
        _feature("lane", id="thin", width_m=0),
        _feature(
            "gate",
            {"type": "LineString", "coordinates": [[0, 0], "x"]},
            id="broken",
            inward="up",
            junction_centre_m=[1],
        ),
        "nonsense",
    )
    with pytest.raises(ConfigError) as caught:
        parse_zones(text, crs=None, source="z.geojson")
    lines = str(caught.value).splitlines()
    assert all(line.startswith("z.geojson: feature ") for line in lines)
    for words in (
        "feature 0 (id 'bow'): geometry: the border crosses itself",
        "feature 1 (id 'typo'): role: expected one of gate, zone, approach, lane, exclusion, found 'zoone'",
        "feature 2 (id 'area-gate'): geometry: a gate is a LineString, found Polygon",
        "feature 3: id:",
        "feature 5 (id 'twice'): id 'twice' is already that of feature 4",
        "feature 6 (id 'empty'): geometry: empty",
        "feature 7 (id 'point'): geometry:",
        "feature 8 (id 'multi'): geometry: a zone is a Polygon, found MultiPolygon; draw one feature for each part",
        "feature 9 (id 'armless'): junction:",
        "feature 10 (id 'unknown'): id:",
        "feature 11 (id 'thin'): width_m: expected a number above 0, found 0",
        "feature 12 (id 'broken'): inward:",
        "feature 12 (id 'broken'): junction_centre_m: expected [x, y] in the survey's metres, found [1]",
        "feature 12 (id 'broken'): geometry: malformed LineString",
        "feature 13: expected an object of type Feature",
    ):
        assert any(line.startswith(f"z.geojson: {words}") for line in lines), words
    assert len(lines) == 15


@pytest.mark.parametrize("text", ["{", "[]", '{"type": "Feature"}', '{"type": "FeatureCollection"}'])
def test_what_is_no_collection_is_refused(text):
    with pytest.raises(ConfigError, match="z"):
        parse_zones(text, crs=None, source="z")


@pytest.mark.parametrize("crs", [None, UTM])
def test_zones_survive_being_written_and_read(crs):
    x, y = (500000, 5700000) if crs else (0, 0)
    zones = [
        Zone("g", "Gate 1", "gate", LineString([(x, y), (x + 5, y + 9)]), "J", {"inward": "left"}),
        Zone("z", "Zürich", "zone", Polygon([(x, y), (x, y + 50), (x + 30, y + 50), (x + 30, y)])),
    ]
    text = json.dumps(zones_to_geojson(zones, crs))
    again = parse_zones(text, crs=crs, source="z")
    for one, other in zip(zones, again, strict=True):
        assert (one.id, one.name, one.role, one.junction) == (other.id, other.name, other.role, other.junction)
        assert dict(one.properties) == dict(other.properties)
        assert one.geometry.hausdorff_distance(other.geometry) < 0.02
    ring = json.loads(text)["features"][1]["geometry"]["coordinates"][0]
    assert Polygon(ring).exterior.is_ccw


def test_points_in_an_exclusion_are_excluded_and_no_others():
    zones = parse_zones(_text(_feature("exclusion", id="x"), _feature("zone", id="y")), crs=None, source="z")
    assert excluded(zones, [15, 15, 31, 0], [5, 11, 5, 0]).tolist() == [True, False, False, True]
    assert excluded(zones[1:], [15], [5]).tolist() == [False]
    assert excluded([], [], []).tolist() == []
