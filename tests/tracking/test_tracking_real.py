"""Pinned simulated sequences and real traffic of others keep their identities."""

import numpy as np
import pandas as pd
import pytest
from tracking_worlds import START, utc

from vtrack_batch.tracking.learn import learn_flow
from vtrack_batch.tracking.track import track

pytestmark = pytest.mark.real
SEEN = ["detection_id", "t_utc", "x_m", "y_m", "red", "green", "blue"]


def sequence(folder, scene, interval_s, missed, until_s):
    rows = pd.read_parquet(folder / "sumo" / f"sequences_{scene}.parquet")
    chosen = np.isclose(rows["interval_s"], interval_s) & np.isclose(rows["missed"], missed) & (rows["seed"] == 31)
    rows = rows[chosen & (rows["t_s"] < until_s)].sample(frac=1, random_state=1).reset_index(drop=True)
    return utc(
        rows.assign(
            detection_id=np.arange(len(rows)), t_utc=START + pd.to_timedelta(rows["t_s"].astype(float), unit="s")
        )
    )


def link_scores(tracks, rows):
    """Precision and recall of links between sightings of one vehicle, misses in between allowed."""
    rows = rows.sort_values(["truth_vehicle", "t_utc"])
    follows = rows["truth_vehicle"].eq(rows["truth_vehicle"].shift(-1))
    true = set(zip(rows["detection_id"][follows], rows["detection_id"].shift(-1)[follows].astype(int), strict=True))
    both = tracks.matches.dropna(subset=["detection_id_from", "detection_id_to"])
    found = set(zip(both["detection_id_from"], both["detection_id_to"], strict=True))
    return len(true & found) / len(found), len(true & found) / len(true)


@pytest.mark.parametrize(
    ("scene", "interval_s", "missed", "low"),
    [
        ("crossing", 1.5, 0.1, 0.985),
        ("crossing", 1.5, 0.2, 0.97),
        ("congested", 1.5, 0.1, 0.985),
        ("road", 2.5, 0.1, 0.96),
    ],
)
def test_links_of_pinned_sequences(shared_data, scene, interval_s, missed, low):
    rows = sequence(shared_data, scene, interval_s, missed, 120)
    precision, recall = link_scores(track(rows[SEEN]), rows)
    assert low < precision <= 1
    assert low < recall <= 1


def test_real_junction_without_colour(shared_data):
    rows = pd.read_csv(shared_data / "songdo" / "tracks.csv")
    rng = np.random.default_rng(0)
    rows = rows[(rows["Frame_Number"] % 15 == 0) & (rng.random(len(rows)) > 0.1)]
    jitter = rng.normal(0, 0.3, (len(rows), 2))
    world = utc(
        pd.DataFrame(
            {
                "detection_id": rng.permutation(len(rows)),
                "t_utc": (START + pd.to_timedelta(rows["Frame_Number"] / 29.97, unit="s")).to_numpy(),
                "x_m": rows["Local_X"].to_numpy() + jitter[:, 0],
                "y_m": rows["Local_Y"].to_numpy() + jitter[:, 1],
                "truth_vehicle": rows["Vehicle_ID"].to_numpy(),
            }
        )
    )
    precision, recall = link_scores(track(world.drop(columns="truth_vehicle")), world)
    assert precision > 0.98
    assert recall > 0.98


def test_a_flow_map_is_learned_without_truth(shared_data):
    rows = sequence(shared_data, "road", 1.5, 0.1, 90)
    flow = learn_flow(rows[SEEN])
    # one-way: next to nothing drives against the stream
    assert len(flow.xy) > 500
    along = flow.velocity @ np.array([np.cos(np.pi * 0.05), np.sin(np.pi * 0.05)])
    assert min((along > -1).mean(), np.abs(along).mean() / 10) > 0.95 or (along < 1).mean() > 0.99
