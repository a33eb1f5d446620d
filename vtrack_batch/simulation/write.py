"""The rim: write a simulated archive, its truth, its detections, its zones and a survey file ready to run."""

from __future__ import annotations

import io
import shutil
import warnings
from collections.abc import Iterable
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
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.transform import Affine
from ruamel.yaml import YAML

from vtrack_batch.errors import CannotCreate, ConfigError
from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation import detector, driving, paint, render, sumo, traffic, truth, zones
from vtrack_batch.simulation.fleet import Fleet
from vtrack_batch.simulation.flight import Flight, fly
from vtrack_batch.simulation.ground import Parked, filled
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.places import Places, find_places
from vtrack_batch.simulation.roadnet import RoadNet, read_net
from vtrack_batch.simulation.scenery import Scenery, photographed, procedural
from vtrack_batch.simulation.stage import Stage, compass_deg, local_stage, mapped_stage
from vtrack_batch.simulation.view import View
from vtrack_batch.traffic.params import TrafficParams

PLATFORM = "main"
"""Name that an archive without sub-directories gives its only platform."""
_FRAME, _GAIN, _DETECTOR = 2, 3, 4


@dataclass(frozen=True)
class _Photo:
    """A picture of the ground: ``rgb`` (H, W, 3) uint8, its geotransform (corner based) and CRS, null = none."""

    rgb: NDArray[np.uint8]
    transform: Affine
    crs: str | None

    @property
    def gsd_m(self) -> float:
        return float(np.hypot(self.transform.a, self.transform.d))


@dataclass(frozen=True)
class _Ground:
    """What frames are taken of: an orthophoto whose CRS they keep, a mere background, or neither; each day's flight."""

    photo: _Photo | None
    background: _Photo | None
    flights: list[Flight]
    margin_px: int

    @property
    def ending(self) -> str:
        """Ending of the frames' names."""
        return "tif" if self.photo else "jpg"


@dataclass(frozen=True)
class _Day:
    """What one day shows, the painter's tables of its frames, and its truth."""

    scenario: Scenario
    world: truth.World
    camera: render.Camera
    painted: list[Array]
    found: dict[str, pd.DataFrame]


def simulate(scenario: Scenario, out: str | Path, *, workers: int = 1, base: str | Path = ".") -> dict[str, Any]:
    """Write the archive of *scenario* below *out*; return a summary.

    Relative paths in the scenario are taken from *base*. The same scenario gives the same bytes, whatever the
    *workers*. Raises ``ConfigError`` for an orthophoto, network or routes that cannot serve and where SUMO is missing,
    ``CannotCreate`` where *out* holds something else.
    """
    out, base = Path(out), Path(base)
    sumo.home()
    days = [scenario.on_day(number) for number in range(scenario.days)]
    views = [View(day.camera, day.ground, day.light, day.seed, day.interval_s, day.frame_count) for day in days]
    ground = _read_ground(scenario, views, base)
    fresh = _make_folders(scenario, out)
    try:
        stage, places, net, driven = _traffic(scenario, days, out, base, ground)
    except ConfigError:
        if fresh:
            shutil.rmtree(out)
        raise
    scenery = _scenery(scenario, views[0], stage, net, ground)
    cameras = [render.Camera(view, stage, flight, scenery) for view, flight in zip(views, ground.flights, strict=True)]
    shown = [
        _day(day, camera, traffic_of_day, places, ground.ending)
        for day, camera, traffic_of_day in zip(days, cameras, driven, strict=True)
    ]
    found = {name: _all(day.found[name] for day in shown) for name in shown[0].found}
    _write_truth(out, shown, found)
    _write_detections(out, shown)
    (out / "zones.geojson").write_text(zones.zones_geojson(places, stage), encoding="utf-8")
    _write_survey(out, scenario, stage, ground.ending)
    if scenario.frames:
        for day in shown:
            _write_frames(out, day, ground, workers)
    return _summary(out, scenario, found, len(scenery.parked.xy_m))


def _day(
    scenario: Scenario, camera: render.Camera, driven: tuple[Fleet, traffic.Motion], places: Places, ending: str
) -> _Day:
    """Tell what a *camera* sees of a day's traffic."""
    fleet, moved = driven
    names, t_utc = _names_and_times(scenario, ending)
    states = traffic.states_at(moved, camera.view.t_s)
    painted = _painter_tables(camera, fleet, states)
    world = truth.World(
        places, fleet, moved, states, camera.stage, camera.flight, names, t_utc,
        f"{PLATFORM}/{t_utc[0]:%Y%m%dT%H%M%SZ}", scenario.time_zone,
    )  # fmt: skip
    seen = truth.sightings(world, camera, painted)
    return _Day(scenario, world, camera, painted, truth.truth_tables(world, seen, bin_s=TrafficParams().bin_s))


def _all(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of all days, in their order."""
    first, *more = tables
    return pd.concat([first, *more], ignore_index=True) if more else first


def _traffic(
    scenario: Scenario, days: list[Scenario], out: Path, base: Path, ground: _Ground
) -> tuple[Stage, Places, RoadNet, list[tuple[Fleet, traffic.Motion]]]:
    """Build the roads, and drive on them each day."""
    net_file = driving.network(scenario, out / "sumo", base=base, reach_m=_reach_m(scenario, ground))
    net = read_net(net_file)
    stage = _stage(scenario, ground, net)
    places = find_places(net, stage)
    driven = []
    for number, day in enumerate(days, 1):
        folder = out / "sumo" if number == 1 else out / "sumo" / f"day-{number}"
        folder.mkdir(exist_ok=True)
        driven.append(driving.drive(day, folder, base=base, net=net, net_file=net_file, places=places))
    return stage, places, net, driven


def _read_ground(scenario: Scenario, views: list[View], base: Path) -> _Ground:
    """Read the pictures that the scenario names, and fly over them each day."""
    photo = _read_photo(base / scenario.ground.orthophoto) if scenario.ground.orthophoto else None
    behind = scenario.ground.background
    background = _read_photo(base / behind, projected=False) if behind and photo is None else None
    size = (scenario.camera.width_px, scenario.camera.height_px)
    if photo is None:
        return _Ground(None, background, [fly(view, size_px=size, rigid=False) for view in views], 0)
    height, width = photo.rgb.shape[:2]
    flights = [fly(view, size_px=(width, height), rigid=True) for view in views]
    margin = int(np.ceil(max(np.abs(flight.poses[:, :2, 2]).max() for flight in flights))) + 2
    if min(width, height) - 2 * margin < 64:
        raise ConfigError(f"orthophoto: {width} x {height} px leave no room for a drift of {margin} px; lower drift_px")
    return _Ground(photo, None, flights, margin)


def _read_photo(path: Path, *, projected: bool = True) -> _Photo:
    try:
        with warnings.catch_warnings():
            # a background may do without a georeference
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as source:
                bands, crs, transform = source.read(), source.crs, source.transform
                valid = source.dataset_mask() > 0
    except (RasterioError, OSError) as problem:
        raise ConfigError(f"picture {path}: cannot be read ({problem})") from None
    if projected and (crs is None or not crs.is_projected or crs.to_epsg() is None):
        raise ConfigError(f"orthophoto {path}: needs a projected CRS with an EPSG code, found {crs}; reproject it")
    if crs is not None and crs.is_geographic:
        raise ConfigError(f"picture {path}: is in degrees ({crs}); give it a projected CRS, or none")
    if len(bands) < 3 or bands.dtype != np.uint8:
        raise ConfigError(f"picture {path}: needs three bands of 8 bits, found {len(bands)} of {bands.dtype}")
    if not valid.any():
        raise ConfigError(f"picture {path}: needs pixels with data, found none: its mask covers all of it")
    code = f"EPSG:{crs.to_epsg()}" if projected else None
    return _Photo(filled(np.ascontiguousarray(bands[:3].transpose(1, 2, 0)), valid), transform, code)


def _make_folders(scenario: Scenario, out: Path) -> bool:
    """Make the folders and return whether *out* is new; an archive of the very same scenario is written over."""
    record = scenario.model_dump_json(indent=1) + "\n"
    try:
        fresh = not (out.is_dir() and any(out.iterdir()))
        if not fresh:
            held = out / "scenario.json"
            if not (held.is_file() and held.read_text(encoding="utf-8") == record):
                raise CannotCreate(f"{out}: is not empty and was not made from this scenario; choose another folder")
        for folder in ("truth", "sumo", *(["frames"] if scenario.frames else [])):
            (out / folder).mkdir(parents=True, exist_ok=True)
        (out / "scenario.json").write_text(record, encoding="utf-8")
    except OSError as problem:
        raise CannotCreate(f"{out}: cannot be created ({problem})") from None
    return fresh


def _reach_m(scenario: Scenario, ground: _Ground) -> float:
    """Return how far from the middle roads must reach to be well out of view wherever the platform wanders."""
    camera = scenario.camera
    width, height, gsd_m = camera.width_px, camera.height_px, camera.gsd_m
    if ground.photo is not None:
        (height, width), gsd_m = ground.photo.rgb.shape[:2], ground.photo.gsd_m
    return float(gsd_m * (np.hypot(width, height) / 2 + 2.5 * camera.drift_px) + 60.0)


def _stage(scenario: Scenario, ground: _Ground, net: RoadNet) -> Stage:
    camera, axis = scenario.camera, scenario.ground.street_px if scenario.name == "street" else None
    middle = (0.0, 0.0)
    if scenario.network is not None:
        x, y = net.middle_m.tolist() if scenario.centre_m is None else scenario.centre_m
        middle = (float(x), float(y))
    photo, margin = ground.photo, ground.margin_px
    if photo is None:
        local = local_stage(camera, middle_m=middle)
        size, to_ground, crs = (camera.width_px, camera.height_px), local.reference_to_ground, None
    else:
        size = (photo.rgb.shape[1] - 2 * margin, photo.rgb.shape[0] - 2 * margin)
        a = photo.transform @ Affine.translation(margin + 0.5, margin + 0.5)
        to_ground, crs = np.array([[a.a, a.b, a.c], [a.d, a.e, a.f], [0, 0, 1]]), photo.crs
    return mapped_stage(camera, size_px=size, reference_to_ground=to_ground, crs=crs, middle_m=middle, axis_px=axis)


def _scenery(scenario: Scenario, view: View, stage: Stage, net: RoadNet, ground: _Ground) -> Scenery:
    if ground.photo is not None:
        shift = np.array([[1, 0, -ground.margin_px], [0, 1, -ground.margin_px], [0, 0, 1.0]])
        return photographed(view, stage, net, ground.photo.rgb, photo_to_reference=shift)
    if ground.background is not None:
        # middle upon middle
        rgb, untold = ground.background.rgb, ground.background.transform.is_identity
        zoom = 1.0 if untold else ground.background.gsd_m / stage.gsd_m
        there, here = (np.array(rgb.shape[1::-1]) - 1) / 2, np.array([stage.width_px - 1, stage.height_px - 1]) / 2
        x, y = here - zoom * there
        laid = np.array([[zoom, 0, x], [0, zoom, y], [0, 0, 1.0]])
        return photographed(view, stage, net, rgb, photo_to_reference=laid)
    return procedural(view, stage, net, picture=scenario.frames)


def _painter_tables(camera: render.Camera, fleet: Fleet, states: traffic.States) -> list[Array]:
    """Return the painter's table of each frame; brightness varies a little from sighting to sighting."""
    begin = np.searchsorted(states.frame, np.arange(camera.view.frame_count + 1))
    tables = []
    for k in range(camera.view.frame_count):
        part = slice(begin[k], begin[k + 1])
        looks = fleet.looks.take(states.vehicle[part])
        table = render.place(camera, k, looks, xy_m=states.xy_m[part], forward=states.forward[part])
        rng = np.random.default_rng([camera.view.seed, _GAIN, k])
        gain = 1 + camera.view.light.appearance_gain * rng.standard_normal(len(table))
        tables.append(paint.brightened(table, gain))
    return tables


def _names_and_times(scenario: Scenario, ending: str) -> tuple[list[str], pd.DatetimeIndex]:
    """Return file names and times; times are whole milliseconds where the interval is, else microseconds."""
    us = np.round(np.arange(scenario.frame_count) * scenario.interval_s * 1e6).astype(np.int64)
    first = pd.Timestamp(scenario.start).tz_convert("UTC")
    t_utc = pd.DatetimeIndex(first + pd.to_timedelta(us, unit="us")).as_unit("us")
    keep = None if (us % 1000).any() else -3
    stamps = [f"{t:%Y%m%dT%H%M%S.%f}"[:keep] for t in t_utc]
    return [f"{scenario.name}_{stamp}Z.{ending}" for stamp in stamps], t_utc


def _write_truth(out: Path, days: list[_Day], tables: dict[str, pd.DataFrame]) -> None:
    stage = days[0].camera.stage
    for name, table in tables.items():
        path = out / "truth" / f"{name}.parquet"
        if "geometry" in table:
            geopandas.GeoDataFrame(table, geometry="geometry", crs=stage.crs).to_parquet(path, index=False)
        else:
            table.to_parquet(path, index=False)
    known = _all(_drivers(day) for day in days)
    known.sort_values("vehicle_id").to_parquet(out / "truth" / "vehicles.parquet", index=False)
    others = [
        render.others(day.camera, k).assign(t_utc=t_utc) for day in days for k, t_utc in enumerate(day.world.t_utc)
    ]
    pd.concat(others, ignore_index=True).to_parquet(out / "truth" / "others.parquet", index=False)
    letters = [f"h{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
    poses = pd.DataFrame(np.concatenate([day.camera.flight.poses.reshape(-1, 9) for day in days]), columns=letters)
    poses.insert(0, "frame", np.arange(len(poses)))
    poses.to_csv(out / "truth" / "poses.csv", index=False, lineterminator="\n")
    _write_parked(out, stage, days[0].camera.scenery.parked)


def _drivers(day: _Day) -> pd.DataFrame:
    """Return what SUMO calls the vehicles that are seen."""
    fleet = day.world.fleet
    seen = np.isin(fleet.ids, day.found["trajectories"]["vehicle_id"].to_numpy(object))
    return pd.DataFrame({"vehicle_id": fleet.ids[seen], "sumo_id": np.array(fleet.names, object)[seen]})


def _write_parked(out: Path, stage: Stage, parked: Parked) -> None:
    px = apply(stage.ground_to_reference, parked.xy_m)
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


def _write_detections(out: Path, days: list[_Day]) -> None:
    """Write what a detector would give beside the truth's folder, and whose they are inside it."""
    made = [
        detector.detected(
            day.found["detections"],
            day.found["frames"],
            (day.camera.stage.reference_to_ground, day.camera.flight.poses),
            params=day.scenario.detector,
            rng=np.random.default_rng([day.scenario.seed, _DETECTOR]),
        )
        for day in days
    ]
    _all(found for found, _ in made).to_parquet(out / "detections.parquet", index=False)
    _all(key for _, key in made).to_parquet(out / "truth" / "detection_keys.parquet", index=False)


def _write_survey(out: Path, scenario: Scenario, stage: Stage, ending: str) -> None:
    survey: dict[str, Any] = {
        "survey": {"name": f"simulated {scenario.name}", "time_zone": scenario.time_zone},
        "archive": {"root": "frames", "pattern": f"{scenario.name}_{{time:%Y%m%dT%H%M%S.%fZ}}.{ending}"},
    }
    gsd_m = scenario.camera.gsd_m if stage.crs is None else round(stage.gsd_m, 4)
    survey["georeference"] = {"gsd_m": gsd_m} | ({"crs": stage.crs} if stage.crs else {})
    survey |= {"zones": "zones.geojson", "output": {"root": "results"}}
    text = io.StringIO()
    YAML().dump(survey, text)
    (out / "survey.yaml").write_text(text.getvalue(), encoding="utf-8")


def _write_frames(out: Path, day: _Day, ground: _Ground, workers: int) -> None:
    camera, names = day.camera, day.world.paths

    def one(k: int) -> None:
        rng = np.random.Generator(np.random.SFC64([camera.view.seed, _FRAME, k]))
        image = render.render(camera, k, day.painted[k], rng=rng)
        path = out / "frames" / names[k]
        if ground.photo is None:
            quality = camera.view.camera.jpeg_quality
            path.write_bytes(simplejpeg.encode_jpeg(image, quality=quality, colorsubsampling="420"))
        else:
            # the pose is a pure translation: the corner of the frame lies at minus that much of the reference frame
            shift = ground.margin_px - camera.flight.poses[k, :2, 2]
            _write_geotiff(path, image, ground.photo.transform @ Affine.translation(*shift), str(ground.photo.crs))

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
        "frames": len(tables["frames"]),
        "interval_s": scenario.interval_s,
        "vehicles": len(tables["trajectories"]),
        "vehicles_per_frame": round(float(len(tables["detections"]) / len(tables["frames"])), 1),
        "fewest_in_a_frame": int(per_frame.min()) if len(per_frame) == len(tables["frames"]) else 0,
        "trips_from_gate_to_gate": int(known.sum()),
        "mean_moving_speed_kmh": round(float(moving.mean() * 3.6), 1) if len(moving) else None,
        "parked_cars": parked,
        "survey": str(out / "survey.yaml"),
    }
