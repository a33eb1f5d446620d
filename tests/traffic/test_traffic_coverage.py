"""Coverage: null is not zero."""

import numpy as np
import pandas as pd
import pytest
from traffic_worlds import area, gate, straight, trajectories_of, view

from vtrack_batch.model.tables import TABLES
from vtrack_batch.model.views import Views
from vtrack_batch.traffic.coverage import shares_visible
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.places import places_of

NOBODY = straight("a", (0, 0), (1, 0), [0, 1]).iloc[:0]
ZONES = [gate("g", (0, -10), (0, 10)), area("half", 100, -10, 140, 10), area("off", 400, 0, 420, 30)]


def _coverage(views, zones=ZONES, **params):
    out = measure(trajectories_of(NOBODY), NOBODY, zones, views, time_zone="UTC", params=TrafficParams(**params))
    return out["coverage"], out


def test_seconds_frames_and_shares_of_a_hovering_platform():
    coverage, _ = _coverage(view(np.arange(0, 900 + 600, 1.5)))
    assert list(coverage.columns) == list(TABLES["coverage"].column_names)
    cell = coverage.set_index(["place", coverage["bin_start_utc"].dt.minute])
    for place, share in (("g", 1.0), ("half", 0.5)):
        assert cell.loc[(place, 0), "observed_s"] == pytest.approx(900)
        # The last frame speaks for no time after it.
        assert cell.loc[(place, 15), "observed_s"] == pytest.approx(600 - 1.5)
        assert cell.loc[(place, 0), "frames"] == 600
        assert cell.loc[(place, 15), "frames"] == 400
        assert cell.loc[(place, 0), "share_visible"] == pytest.approx(share)
    assert (cell.loc["off", ["observed_s", "frames", "share_visible"]] == 0).all(axis=None)
    assert coverage["completeness"].isna().all()


def test_gaps_count_only_as_far_as_a_frame_speaks():
    coverage, _ = _coverage(view([0, 2, 4, 104, 106]), ZONES[:1], max_gap_s=10.0)
    assert coverage["observed_s"].tolist() == pytest.approx([2 + 2 + 10 + 2])


def test_two_platforms_over_one_place_do_not_count_twice():
    views = {**view(np.arange(0, 100, 2.0), sequence="one"), **view(np.arange(50, 151, 2.0), sequence="two")}
    coverage, _ = _coverage(views, ZONES[:1])
    assert coverage["observed_s"].tolist() == pytest.approx([150])
    assert coverage["frames"].tolist() == [50 + 51]


def test_a_passing_platform_sees_each_place_in_its_time():
    t_s = np.arange(0, 101, 1.0)
    still = view(t_s, -50, -50, 50, 50)["s"]
    corners = still.corners_m + (t_s * 10 - 500)[:, None, None] * np.array([1.0, 0.0])
    moving = {"s": Views("s", still.t_utc, corners, still.position_sigma_m)}
    coverage, out = _coverage(moving, [gate("near", (-300, -5), (-300, 5)), gate("far", (300, -5), (300, 5))])
    # 100 m of view pass at 10 m/s, frames at both rims included.
    assert coverage["observed_s"].tolist() == pytest.approx([11, 11])
    od = out["od_pairs"].set_index(["origin", "destination"])
    assert od.loc[("near", "far"), "status"] == "not_observed"
    assert np.isnan(od.loc[("near", "far"), "count"])
    assert od.loc[("near", "unknown"), "count"] == 0
    assert od.loc[("near", "unknown"), "observed_s"] == pytest.approx(11)


def test_status_follows_the_observed_share_of_the_bin():
    t_s = np.r_[np.arange(0, 900, 3.0), np.arange(900, 1700, 3.0), np.arange(1800, 1860, 3.0)]
    _, out = _coverage(view(t_s), ZONES)
    flows = out["flows"].set_index(["place", out["flows"]["bin_start_utc"].dt.minute])
    assert flows.loc["g", "status"].tolist() == ["observed", "partial", "partial"]
    assert flows.loc["g", "count"].tolist() == [0, 0, 0]
    assert flows.loc["off", "status"].tolist() == ["not_observed"] * 3
    assert flows.loc["off", ["count", "flow_vph", "density_vpkm"]].isna().all(axis=None)
    speeds = out["speeds"]
    assert speeds.loc[speeds["place"] == "off", "vehicles"].isna().all()
    assert (speeds.loc[speeds["place"] == "g", "vehicles"] == 0).all()


@pytest.mark.parametrize("turn", [1, -1])
def test_shares_hold_for_either_order_of_corners(turn):
    footprint = np.array([[[0, 0], [10, 0], [12, 8], [-1, 9]]], float)[:, ::turn]
    zones = [
        area("all", 1, 1, 9, 7),
        area("part", 5, -4, 7, 4),
        gate("line", (2, -2), (2, 6)),
        area("no", 20, 0, 30, 9),
    ]
    places = places_of(zones, site_centre=None, params=TrafficParams())
    share = dict(zip([place.id for place in places], shares_visible(footprint, places)[0], strict=True))
    assert share == pytest.approx({"all": 1.0, "line": 0.75, "no": 0.0, "part": 0.5})


def test_nothing_at_all_gives_empty_tables_with_all_columns():
    for zones, views in (([], {}), (ZONES, {}), ([], view([0, 2]))):
        out = measure(trajectories_of(NOBODY), NOBODY, zones, views, time_zone="UTC")
        for name, table in out.items():
            if name != "trajectories":
                assert list(table.columns) == list(TABLES[name].column_names)
        assert not (out["od_pairs"]["count"] > 0).any()
        assert len(out["crossings"]) == len(out["turns"]) == len(out["stops"]) == 0


def test_without_views_what_was_counted_is_partial():
    points = straight("a", (-20, 0), (5, 0), np.arange(0, 12, 1.5))
    out = measure(trajectories_of(points), points, ZONES[:1], {}, time_zone="UTC")
    assert out["flows"]["count"].tolist() == [1, 1]
    assert set(out["flows"]["status"]) == {"partial"}
    assert out["flows"]["flow_vph"].isna().all()
    assert out["od_pairs"]["count"].sum() == 2


def test_types_are_those_declared():
    points = straight("a", (-20, 0), (5, 0), np.arange(0, 12, 1.5))
    out = measure(trajectories_of(points), points, ZONES, view([0, 3, 6]), time_zone="UTC")
    for name, table in out.items():
        for column in TABLES[name].columns:
            if column.name in table and column.type == "time":
                assert table[column.name].dtype == pd.DatetimeTZDtype("us", "UTC")
            elif column.name in table and column.type == "float64":
                assert table[column.name].dtype == np.float64
            elif column.name in table and column.type == "int32":
                assert str(table[column.name].dtype).lower() == "int32"
