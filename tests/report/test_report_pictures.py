"""Pictures show the tables: things lie where the tables say, and the same tables give the same bytes."""

import cv2
import numpy as np
import pandas as pd
import pytest
from shapely.geometry import LineString, Polygon

from vtrack_batch.model import homography
from vtrack_batch.model.zones import Zone
from vtrack_batch.report.frame_strip import box_corners_px
from vtrack_batch.report.pictures import AnnotatedFrame, background_picture, frame_strip, trajectory_map

GSD_M = 0.5
GROUND = np.array([[GSD_M, 0, GSD_M / 2], [0, -GSD_M, -GSD_M / 2], [0, 0, 1.0]])
YELLOW = (253, 231, 37)


def opened(png):
    return cv2.cvtColor(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def land(width=800, height=450):
    rng = np.random.default_rng(0)
    return rng.integers(90, 130, (height, width, 3)).astype(np.uint8)


def drives(speeds=(5.0, 30.0), rows=(100, 300), points=40):
    """Vehicles that drive to the right along rows of the reference frame."""
    tables = []
    for number, (speed, row) in enumerate(zip(speeds, rows, strict=True)):
        t = np.arange(points)
        ground = homography.apply(GROUND, np.stack([50 + t * 15.0, np.full(points, float(row))], -1))
        t_utc = pd.Timestamp("2026-05-17T06:00Z") + pd.to_timedelta(t * 0.5, unit="s")
        tables.append(
            pd.DataFrame(
                {"vehicle_id": f"v-{number}", "t_utc": t_utc, "x_m": ground[:, 0], "y_m": ground[:, 1]}
            ).assign(speed_mps=speed)
        )
    track_points = pd.concat(tables, ignore_index=True)
    return track_points, track_points[["vehicle_id"]].drop_duplicates()


def coloured(picture, colour, tolerance=12):
    return np.argwhere((np.abs(picture.astype(int) - colour) <= tolerance).all(-1))


class TestTrajectoryMap:
    def test_fast_vehicle_is_yellow_where_it_drove(self):
        points, trajectories = drives()
        png = trajectory_map(land(), GROUND, points, trajectories, title="t")
        picture = opened(png)
        scale = 1200 / 800
        left, bottom = 16, picture.shape[0] - 16
        top = bottom - 450 * scale
        yellow = coloured(picture[:, : left + 1200], YELLOW)
        assert len(yellow) > 500
        assert abs(np.median(yellow[:, 0]) - (top + 300.5 * scale)) <= 2
        assert abs(yellow[:, 1].min() - (left + 50.5 * scale)) <= 6
        assert abs(yellow[:, 1].max() - (left + 635.5 * scale)) <= 6

    def test_same_bytes_in_any_order_of_rows(self):
        points, trajectories = drives()
        zones = [
            Zone("west", "west", "gate", LineString([(40, -10), (40, -200)])),
            Zone("$x_1$", "mathematics is no text", "exclusion", Polygon([(100, -20), (150, -20), (150, -90)])),
        ]
        once = trajectory_map(land(), GROUND, points, trajectories, zones, title="a_b $c$ <d>")
        again = trajectory_map(
            land(), GROUND, points.sample(frac=1, random_state=1), trajectories[::-1], zones[::-1], title="a_b $c$ <d>"
        )
        assert once == again

    def test_only_vehicles_of_the_trajectories_are_drawn(self):
        points, trajectories = drives()
        png = trajectory_map(land(), GROUND, points, trajectories.iloc[:1], title="slow one only")
        assert len(coloured(opened(png)[:, :1216], YELLOW)) == 0

    def test_gates_are_drawn_where_they_lie_and_far_ones_not_at_all(self):
        points, trajectories = drives()
        gate = Zone("g", "g", "gate", LineString([(200, -40), (200, -210)]))
        far = Zone("far", "far", "gate", LineString([(9000, -40), (9000, -210)]))
        bare = opened(trajectory_map(land(), GROUND, points, trajectories, title="t")).astype(int)
        with_gate = opened(trajectory_map(land(), GROUND, points, trajectories, [gate, far], title="t")).astype(int)
        changed = np.argwhere(np.abs(with_gate - bare).sum(-1) > 60)
        assert abs(np.median(changed[:, 1]) - (16 + 400 * 1.5)) <= 4
        assert np.ptp(changed[:, 1]) < 60

    @pytest.mark.parametrize("size", [(3600, 2100), (200, 90), (300, 1900)])
    def test_any_size_of_frame(self, size):
        points, trajectories = drives()
        picture = opened(trajectory_map(land(*size), GROUND, points, trajectories, title="t"))
        assert max(picture.shape[:2]) <= 2600
        assert picture.shape[0] >= 300

    def test_no_vehicle_at_all(self):
        points, trajectories = drives()
        picture = opened(trajectory_map(land(), GROUND, points.iloc[:0], trajectories.iloc[:0], title="empty"))
        assert picture.shape[1] > 1200

    def test_standing_and_single_points_and_unknown_speeds(self):
        points, trajectories = drives(points=1)
        points["speed_mps"] = np.nan
        assert trajectory_map(land(), GROUND, points, trajectories, title="t")


def detections(*rows):
    columns = ["col_px", "row_px", "length_m", "width_m", "heading_deg", "vehicle_id"]
    return pd.DataFrame(rows, columns=columns).astype({"vehicle_id": object})


class TestFrameStrip:
    @pytest.mark.parametrize(("heading_deg", "axis"), [(0, (0, -1)), (90, (1, 0)), (45, (0.7071, -0.7071))])
    def test_boxes_lie_along_their_heading(self, heading_deg, axis):
        corners = box_corners_px(detections((100, 60, 12.0, 4.0, heading_deg, "v")), GROUND)[0]
        front, back = corners[:2].mean(0), corners[2:].mean(0)
        np.testing.assert_allclose(corners.mean(0), (100, 60), atol=1e-9)
        np.testing.assert_allclose((front - back) / 24, axis, atol=1e-3)
        np.testing.assert_allclose(np.linalg.norm(corners[0] - corners[1]), 8, atol=1e-9)

    def test_anamorphic_pixels_squeeze_boxes(self):
        squeezed = np.diag([1.0, -0.5, 1.0])
        corners = box_corners_px(detections((50, 50, 10.0, 4.0, 90, "v"), (50, 50, 10.0, 4.0, 0, "v")), squeezed)
        np.testing.assert_allclose(np.ptp(corners[0], axis=0), (10, 8))
        np.testing.assert_allclose(np.ptp(corners[1], axis=0), (4, 20))

    def frames(self, count=4, size=(400, 250)):
        shown = []
        for n in range(count):
            found = detections((80 + 20 * n, 120, 4.5, 1.8, 90, "v-a"), (300, 60, 4.5, 1.8, 30, None))
            shown.append(
                AnnotatedFrame(land(*size), GROUND, pd.Timestamp("2026-05-17T06:00Z") + pd.Timedelta(n, "s"), found)
            )
        return shown

    def test_a_vehicle_keeps_its_colour_and_moves(self):
        picture = opened(frame_strip(self.frames(2)))
        colour = (86, 180, 233)
        half = picture.shape[1] // 2
        places = [coloured(part, colour, 20).mean(0) for part in (picture[:, :half], picture[:, half:])]
        assert places[1][1] - places[0][1] > 20
        assert abs(places[1][0] - places[0][0]) < 3

    def test_same_bytes(self):
        assert frame_strip(self.frames()) == frame_strip(self.frames())

    @pytest.mark.parametrize("count", [1, 2, 3, 5])
    def test_any_number_of_frames(self, count):
        assert opened(frame_strip(self.frames(count))).shape[0] > 100
        with pytest.raises(ValueError, match="needs a frame"):
            frame_strip([])

    def test_large_frames_are_shown_where_vehicles_are(self):
        rows = [(2500 + 30 * n, 1800, 4.5, 1.8, 90, f"v-{n}") for n in range(12)]
        frame = AnnotatedFrame(land(3000, 2000), GROUND, pd.Timestamp("2026-05-17T06:00Z"), detections(*rows))
        picture = opened(frame_strip([frame]))
        assert picture.shape[1] <= 960
        assert len(coloured(picture, (86, 180, 233), 20)) > 20

    def test_frames_without_detections(self):
        frame = AnnotatedFrame(land(), GROUND, pd.Timestamp("2026-05-17T06:00Z"), detections())
        assert opened(frame_strip([frame])).shape[1] > 300


def test_background_marks_what_was_never_seen():
    unseen = np.zeros((450, 800), bool)
    unseen[:, :100] = True
    picture = opened(background_picture(land(), unseen=unseen))
    assert set(np.unique(picture[:, :100])) == {120, 160}
    np.testing.assert_array_equal(picture[:, 100:], land()[:, 100:])


@pytest.mark.real
def test_map_of_rendered_truth(shared_data):
    folder = shared_data / "rendered" / "city"
    truth = pd.read_csv(folder / "truth.csv")
    t = pd.to_datetime(pd.read_csv(folder / "times.csv")["time"], utc=True)
    ground = homography.apply(GROUND, truth[["ref_col_px", "ref_row_px"]].to_numpy())
    points = truth.assign(x_m=ground[:, 0], y_m=ground[:, 1], vehicle_id="v-" + truth["vehicle"].astype(str))
    points["t_utc"] = t.iloc[truth["frame"]].array
    png = trajectory_map(land(1920, 1080), GROUND, points, points[["vehicle_id"]].drop_duplicates(), title="city")
    assert 50_000 < len(png) < 8_000_000
