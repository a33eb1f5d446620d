"""Made-up traffic with known motion, and what tracking made of it."""

import numpy as np
import pandas as pd

START = pd.Timestamp("2026-05-17T08:00:00Z")


def street(interval_s=1.5, frames=30, vehicles=16, missed=0.0, seed=0, colour=True, noise_m=0.3):
    """Two opposite streams without overtaking, 600 m x 8 m; in and out at the ends; ``truth`` is the vehicle."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames) * interval_s
    east = np.arange(vehicles) % 2 == 0
    speed = np.where(east, rng.uniform(12.1, 12.9, vehicles), -rng.uniform(9.1, 9.7, vehicles))
    x0 = np.where(east, 0.0, 600.0) - speed * (np.arange(vehicles) // 2) * 2.6
    x = x0[:, None] + speed[:, None] * t
    paint = rng.uniform(20, 235, (vehicles, 3))
    vehicle, frame = np.nonzero((x >= 0) & (x <= 600) & (rng.random(x.shape) >= missed))
    xy = np.column_stack([x[vehicle, frame], np.where(east[vehicle], -2.0, 2.0)]) + rng.normal(
        0, noise_m, (len(frame), 2)
    )
    table = pd.DataFrame({"t_utc": times(t[frame]), "x_m": xy[:, 0], "y_m": xy[:, 1], "truth": vehicle})
    if colour:
        table[["red", "green", "blue"]] = np.clip(paint[vehicle] + rng.normal(0, 4, (len(frame), 3)), 0, 255)
    table["speed"] = np.abs(speed[vehicle])
    table.insert(0, "detection_id", [f"d{n:05d}" for n in rng.permutation(len(table))])
    return table.sample(frac=1, random_state=seed).reset_index(drop=True)


def times(seconds):
    return pd.Series(START + pd.to_timedelta(np.asarray(seconds, float), unit="s")).dt.as_unit("us").to_numpy()


def utc(table):
    """Times as pandas columns in UTC."""
    return table.assign(t_utc=pd.to_datetime(table["t_utc"], utc=True).dt.as_unit("us"))


def labels(tracks, world):
    """One row per sighting on a track: ``vehicle_id`` and ``truth``."""
    points = tracks.track_points.dropna(subset=["detection_id"])
    return points.merge(world[["detection_id", "truth", "speed"]], on="detection_id")
