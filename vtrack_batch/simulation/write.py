"""The rim: write a simulated archive, its truth, its zones and a survey file ready to run."""

from __future__ import annotations

import io
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import geopandas
import numpy as np
import pandas as pd
import rasterio
import simplejpeg
from numpy.typing import NDArray
from rasterio.errors import RasterioError
from rasterio.transform import Affine
from ruamel.yaml import YAML

from vtrack_batch.errors import CannotCreate, ConfigError
from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation import fleet, ground, network, paint, render, traffic, truth, zones
from vtrack_batch.simulation.flight import Flight, fly
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.stage import Stage, compass_deg, local_stage, mapped_stage
from vtrack_batch.traffic.params import TrafficParams

PLATFORM = "main"
"""Name that an archive without sub-directories gives its only platform."""
_FLEET, _FLIGHT, _GROUND, _FRAME, _GAIN = range(5)
_ASPHALT_RGB = (101.0, 101.0, 104.0)


@dataclass(frozen=True)
class _Photo:
    """An orthophoto: ``rgb`` (H, W, 3) uint8, its geotransform (corner based) and CRS."""

    rgb: NDArray[np.uint8]
    transform: Affine
    crs: str


def simulate(scenario: Scenario, out: str | Path, *, workers: int = 1, base: str | Path = ".") -> dict[str, Any]:
    """Write the archive of *scenario* below *out*: frames/, truth/, zones.geojson, survey.yaml; return a summary.

    A relative orthophoto path is taken from *base*. The same scenario gives the same bytes, whatever the *workers*.
    Raises ``ConfigError`` for an orthophoto that cannot serve, ``CannotCreate`` where *out* holds something else.
    """
    out = Path(out)
    photo = _read_photo(Path(base) / scenario.orthophoto) if scenario.orthophoto else None
    _make_folders(scenario, out)
    flight, stage = _flight_and_stage(scenario, photo)
    arm_m = _arm_m(scenario, stage)
    net = network.crossing(arm_m=arm_m) if scenario.scene == "crossing" else network.street(arm_m=arm_m)
    rng = np.random.default_rng([scenario.seed, _FLEET])
    vehicles = fleet.draw_fleet(net, scenario, rng=rng)
    marks_s = net.marks_s(zones.gate_distances(net, stage))
    states = traffic.simulate_traffic(
        net, vehicles, scenario, marks_s=marks_s, offset_s=float(rng.uniform(0, traffic.cycle_s(scenario)))
    )
    light = paint.sun(scenario.sun_azimuth_deg, scenario.sun_elevation_deg)
    below, parked = _ground(net, scenario, stage, light, photo)
    camera = render.Camera(below, stage, flight, light, scenario)
    tables = _painter_tables(camera, vehicles, states)
    names, t_utc = _names_and_times(scenario, ".tif" if photo else ".jpg")
    world = truth.World(
        net, vehicles, states, stage, flight, names, t_utc,
        f"{PLATFORM}/{t_utc[0]:%Y%m%dT%H%M%SZ}", scenario.time_zone,
    )  # fmt: skip
    seen = truth.sightings(world, tables, _background(camera, states))
    found = truth.truth_tables(world, seen, bin_s=TrafficParams().bin_s)
    _write_truth(out, world, found, parked)
    (out / "zones.geojson").write_text(zones.zones_geojson(net, stage), encoding="utf-8")
    _write_survey(out, scenario, stage)
    if scenario.frames:
        _write_frames(out, camera, tables, names, photo, workers)
    return _summary(out, scenario, found, len(parked.xy_m))


def _read_photo(path: Path) -> _Photo:
    try:
        with rasterio.open(path) as source:
            bands, crs, transform = source.read(), source.crs, source.transform
    except (RasterioError, OSError) as problem:
        raise ConfigError(f"orthophoto {path}: cannot be read ({problem})") from None
    if crs is None or not crs.is_projected or crs.to_epsg() is None:
        raise ConfigError(f"orthophoto {path}: needs a projected CRS with an EPSG code, found {crs}")
    if len(bands) < 3 or bands.dtype != np.uint8:
        raise ConfigError(f"orthophoto {path}: needs three bands of 8 bits, found {len(bands)} of {bands.dtype}")
    return _Photo(np.ascontiguousarray(bands[:3].transpose(1, 2, 0)), transform, f"EPSG:{crs.to_epsg()}")


def _make_folders(scenario: Scenario, out: Path) -> None:
    """Make the folders; one that holds an archive of the very same scenario is written over."""
    record = scenario.model_dump_json(indent=1) + "\n"
    try:
        if out.is_dir() and any(out.iterdir()):
            held = out / "scenario.json"
            if not (held.is_file() and held.read_text(encoding="utf-8") == record):
                raise CannotCreate(f"{out}: is not empty and was not made from this scenario; choose another folder")
        for folder in (out / "truth", *([out / "frames"] if scenario.frames else [])):
            folder.mkdir(parents=True, exist_ok=True)
        (out / "scenario.json").write_text(record, encoding="utf-8")
    except OSError as problem:
        raise CannotCreate(f"{out}: cannot be created ({problem})") from None


def _flight_and_stage(scenario: Scenario, photo: _Photo | None) -> tuple[Flight, Stage]:
    rng = np.random.default_rng([scenario.seed, _FLIGHT])
    if photo is None:
        stage = local_stage(scenario)
        return fly(scenario, size_px=(stage.width_px, stage.height_px), rigid=False, rng=rng), stage
    height, width = photo.rgb.shape[:2]
    flight = fly(scenario, size_px=(width, height), rigid=True, rng=rng)
    margin = _margin_px(flight)
    size = (width - 2 * margin, height - 2 * margin)
    if min(size) < 64:
        raise ConfigError(f"orthophoto: {width} x {height} px leave no room for a drift of {margin} px; lower drift_px")
    a = photo.transform @ Affine.translation(margin + 0.5, margin + 0.5)
    to_ground = np.array([[a.a, a.b, a.c], [a.d, a.e, a.f], [0, 0, 1]])
    return flight, mapped_stage(scenario, size_px=size, reference_to_ground=to_ground, crs=photo.crs)


def _margin_px(flight: Flight) -> int:
    return int(np.ceil(np.abs(flight.poses[:, :2, 2]).max())) + 2


def _arm_m(scenario: Scenario, stage: Stage) -> float:
    """Return how far arms reach: well out of view wherever the platform wanders, and 450 m where that is little."""
    far = apply(stage.reference_to_ground, np.array([[0, 0], [stage.width_px, stage.height_px]]))
    beyond = float(np.hypot(*(far[1] - far[0]))) / 2 + 2.5 * scenario.drift_px * stage.gsd_m + 60.0
    return max(beyond, 450.0 if scenario.scene == "crossing" else 0.0)


def _ground(
    net: network.Network, scenario: Scenario, stage: Stage, light: paint.Sun, photo: _Photo | None
) -> tuple[ground.Ground, ground.Parked]:
    if photo is not None:
        margin = (np.array(photo.rgb.shape[1::-1]) - [stage.width_px, stage.height_px]) // 2
        shift = np.array([[1, 0, -margin[0]], [0, 1, -margin[1]], [0, 0, 1.0]])
        return ground.photo_ground(photo.rgb, to_reference=shift)
    if not scenario.frames:
        flat = np.full((1, 1, 3), np.round(_ASPHALT_RGB), np.uint8)
        return ground.photo_ground(flat, to_reference=np.eye(3))
    rng = np.random.default_rng([scenario.seed, _GROUND])
    return ground.town_ground(net, scenario, stage, light, rng=rng)


def _painter_tables(camera: render.Camera, vehicles: fleet.Fleet, states: traffic.States) -> list[Array]:
    """Return the painter's table of each frame; brightness varies a little from sighting to sighting."""
    begin = np.searchsorted(states.frame, np.arange(camera.scenario.frame_count + 1))
    tables = []
    for k in range(camera.scenario.frame_count):
        part = slice(begin[k], begin[k + 1])
        looks = vehicles.looks.take(states.vehicle[part])
        table = render.place(camera, k, looks, xy_m=states.xy_m[part], forward=states.forward[part])
        rng = np.random.default_rng([camera.scenario.seed, _GAIN, k])
        gain = 1 + camera.scenario.appearance_gain * rng.standard_normal(len(table))
        tables.append(paint.brightened(table, gain))
    return tables


def _background(camera: render.Camera, states: traffic.States) -> list[Array]:
    """Return per frame the ground's colour (n, 3) below each vehicle's centre."""
    to_image = np.linalg.inv(camera.ground.to_reference) @ camera.stage.scene_to_frame(np.eye(3))
    col, row = np.round(apply(to_image, states.xy_m)).astype(int).T
    height, width = camera.ground.rgba.shape[:2]
    rgb = camera.ground.rgba[np.clip(row, 0, height - 1), np.clip(col, 0, width - 1), :3].astype(float)
    return np.split(rgb, np.searchsorted(states.frame, np.arange(1, camera.scenario.frame_count)))


def _names_and_times(scenario: Scenario, ending: str) -> tuple[list[str], pd.DatetimeIndex]:
    """Return file names and times; times are whole milliseconds where the interval is, else microseconds."""
    us = np.round(np.arange(scenario.frame_count) * scenario.interval_s * 1e6).astype(np.int64)
    first = pd.Timestamp(scenario.start).tz_convert("UTC")
    t_utc = pd.DatetimeIndex(first + pd.to_timedelta(us, unit="us")).as_unit("us")
    keep = None if (us % 1000).any() else -3
    stamps = [f"{t:%Y%m%dT%H%M%S.%f}"[:keep] for t in t_utc]
    return [f"{scenario.scene}_{stamp}Z{ending}" for stamp in stamps], t_utc


def _write_truth(out: Path, world: truth.World, tables: dict[str, pd.DataFrame], parked: ground.Parked) -> None:
    for name, table in tables.items():
        path = out / "truth" / f"{name}.parquet"
        if "geometry" in table:
            geopandas.GeoDataFrame(table, geometry="geometry", crs=world.stage.crs).to_parquet(path, index=False)
        else:
            table.to_parquet(path, index=False)
    letters = [f"h{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
    poses = pd.DataFrame(world.flight.poses.reshape(-1, 9), columns=letters)
    poses.insert(0, "frame", np.arange(len(poses)))
    poses.to_csv(out / "truth" / "poses.csv", index=False, lineterminator="\n")
    px = apply(world.stage.ground_to_reference, parked.xy_m)
    pd.DataFrame(
        {
            "ref_col_px": px[:, 0],
            "ref_row_px": px[:, 1],
            "x_m": parked.xy_m[:, 0],
            "y_m": parked.xy_m[:, 1],
            "length_m": parked.looks.length_m,
            "width_m": parked.looks.width_m,
            "heading_deg": np.mod(compass_deg(parked.forward), 180.0),
        }
    ).round(4).to_csv(out / "truth" / "parked.csv", index=False, lineterminator="\n")


def _write_survey(out: Path, scenario: Scenario, stage: Stage) -> None:
    ending = "jpg" if stage.crs is None else "tif"
    survey: dict[str, Any] = {
        "survey": {"name": f"simulated {scenario.scene}", "time_zone": scenario.time_zone},
        "archive": {"root": "frames", "pattern": f"{scenario.scene}_{{time:%Y%m%dT%H%M%S.%fZ}}.{ending}"},
    }
    gsd_m = scenario.gsd_m if stage.crs is None else round(stage.gsd_m, 4)
    survey["georeference"] = {"gsd_m": gsd_m} | ({"crs": stage.crs} if stage.crs else {})
    survey |= {"zones": "zones.geojson", "output": {"root": "results"}}
    text = io.StringIO()
    YAML().dump(survey, text)
    (out / "survey.yaml").write_text(text.getvalue(), encoding="utf-8")


def _write_frames(
    out: Path, camera: render.Camera, tables: list[Array], names: list[str], photo: _Photo | None, workers: int
) -> None:
    def one(k: int) -> None:
        rng = np.random.Generator(np.random.SFC64([camera.scenario.seed, _FRAME, k]))
        image = render.render(camera, k, tables[k], rng=rng)
        path = out / "frames" / names[k]
        if photo is None:
            path.write_bytes(
                simplejpeg.encode_jpeg(image, quality=camera.scenario.jpeg_quality, colorsubsampling="420")
            )
        else:
            # the pose is a pure translation: the corner of the frame lies at minus that much of the reference frame
            shift = _margin_px(camera.flight) - camera.flight.poses[k, :2, 2]
            _write_geotiff(path, image, photo.transform @ Affine.translation(*shift), photo.crs)

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with ThreadPoolExecutor(max(1, workers)) as pool:
            list(pool.map(one, range(len(names))))
    finally:
        cv2.setNumThreads(threads)


def _write_geotiff(path: Path, image: NDArray[np.uint8], transform: Affine, crs: str) -> None:
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 3, "photometric": "RGB", "compress": "deflate"}
    size = {"height": image.shape[0], "width": image.shape[1]}
    with rasterio.open(path, "w", crs=crs, transform=transform, **profile, **size) as target:
        target.write(image.transpose(2, 0, 1))


def _summary(out: Path, scenario: Scenario, tables: dict[str, pd.DataFrame], parked: int) -> dict[str, Any]:
    per_frame = tables["detections"].groupby("t_utc").size()
    moving = tables["track_points"].query("state == 'moving'")["speed_mps"]
    trips = tables["trajectories"]
    known = (trips["origin"] != "unknown") & (trips["destination"] != "unknown")
    return {
        "out": str(out),
        "frames": scenario.frame_count,
        "interval_s": scenario.interval_s,
        "vehicles": len(tables["trajectories"]),
        "vehicles_per_frame": round(float(len(tables["detections"]) / scenario.frame_count), 1),
        "fewest_in_a_frame": int(per_frame.min()) if len(per_frame) == scenario.frame_count else 0,
        "trips_from_gate_to_gate": int(known.sum()),
        "mean_moving_speed_kmh": round(float(moving.mean() * 3.6), 1) if len(moving) else None,
        "parked_cars": parked,
        "survey": str(out / "survey.yaml"),
    }
