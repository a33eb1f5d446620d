"""norfair: a SORT-type tracker (a Kalman filter for each track, greedy choice of the nearest), distance as given."""

import numpy as np
from norfair import Detection, OptimizedKalmanFilterFactory, Tracker
from norfair.distances import Distance
from scipy.spatial.distance import cdist
from shapes import linked


def run(tables, settings):
    """Track every sequence."""
    return linked(tables, settings, link)


class PlaceAndColour(Distance):
    """Metres between a detection and a prediction, plus metres per level of colour difference."""

    def __init__(self, metres_per_level):
        self.metres_per_level = metres_per_level

    def get_distances(self, objects, candidates):
        """Return the matrix of distances (candidates, objects)."""
        if not objects or not candidates:
            return np.zeros((len(candidates or ()), len(objects)))
        far = cdist(np.vstack([c.points for c in candidates]), np.vstack([o.estimate for o in objects]))
        if self.metres_per_level and candidates[0].data["rgb"] is not None:
            theirs = np.vstack([o.last_detection.data["rgb"] for o in objects])
            far += self.metres_per_level * cdist(np.vstack([c.data["rgb"] for c in candidates]), theirs)
        return far


def link(frames, interval_s, *, reach_mps, metres_per_level=0.0, memory=0, speed_mps=10.0):
    """Track without any delay of birth; *memory* frames of coasting; *speed_mps* spread of unknown velocities."""
    reach = max(reach_mps * interval_s, 2.0)
    tracker = Tracker(
        distance_function="euclidean",
        distance_threshold=reach,
        hit_counter_max=memory + 1,
        initialization_delay=0,
        past_detections_length=1,
        filter_factory=OptimizedKalmanFilterFactory(
            R=0.3, Q=0.5 * interval_s**2, pos_variance=0.3, vel_variance=(speed_mps * interval_s) ** 2
        ),
    )
    tracker.distance_function = PlaceAndColour(metres_per_level)  # the constructor takes none that is vectorised
    tracks = []
    for frame in frames:
        rgb = frame["rgb"]
        seen = [
            Detection(xy[None], data={"row": row, "rgb": None if rgb is None else rgb[row]})
            for row, xy in enumerate(frame["xy"])
        ]
        tracker.update(seen)
        track = np.full(len(seen), -1)
        # a detection is told by identity: coasting objects still hold their last one, of an earlier frame
        fresh = {id(detection) for detection in seen}
        for known in tracker.tracked_objects:
            if id(known.last_detection) in fresh:
                track[known.last_detection.data["row"]] = known.global_id
        tracks.append(track)
    return tracks
