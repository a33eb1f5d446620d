"""What ``vtrack-batch calibrate`` does: simulate traffic like the survey's, and see which matcher serves it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.archive.sequences import median_interval_s, split_sequences
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.matching.calibration import (
    LabelledPair,
    chosen_setting,
    logarithmic_grid,
    method_rates,
    sweep_rates,
)
from vtrack_batch.matching.params import MatchingParams, RelaxationParams
from vtrack_batch.matching.relaxation import paper_grid
from vtrack_batch.matching.score import model_text
from vtrack_batch.matching.training import Lesson
from vtrack_batch.matching.training import train as train_model
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.index import scan_archive
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.write import simulate
from vtrack_batch.storage.output import make_folder
from vtrack_batch.storage.parquet import read_table
from vtrack_batch.tracking.learn import learn_flow

METHODS = ("default", "untrained", "assignment", "regions", "original", "colour", "opposite", "proposed")
CALIBRATED, RETRAINED = "proposed, calibrated", "default, retrained"
APART_S = 20.0  # pairs this far apart in time are as good as independent
MOST_SWEPT = 12  # pairs; more would cost minutes and choose no better
LESSONS_APART_S = 5.0  # to learn from, nearer ones serve as well
DRIVES = 4  # of seeds of their own; every other one judges what the others chose
COLUMNS = ["x_m", "y_m", "red", "green", "blue", "vehicle"]
ALIKE = 0.15  # a number of vehicles within this share of the survey's is like it
MOST_SCALE = 8.0
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Drive:
    """What the detector saw of one simulated drive: a table of sightings, and of every frame who it was."""

    seed: int
    sightings: pd.DataFrame
    images: list[pd.DataFrame]
    interval_s: float

    def pairs(self, apart_s: float) -> list[LabelledPair]:
        """Return pairs of consecutive frames, *apart_s* from one pair to the next; empty frames make none."""
        step = max(1, round(apart_s / self.interval_s))
        both = [(self.images[at], self.images[at + 1]) for at in range(0, len(self.images) - 1, step)]
        return [LabelledPair(*images, self.interval_s) for images in both if all(len(image) for image in images)]


@dataclass(frozen=True)
class Calibration:
    """What was simulated, the setting that was chosen, and the label rates (per cent) on drives not chosen on.

    ``rates`` has a row per method: ``method, rate, lo, hi``, the 95 % interval of the mean over pairs.
    """

    interval_s: float
    vehicles: float
    pairs: int
    chosen: Mapping[str, float]
    rates: pd.DataFrame
    model: Path | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return everything for JSON."""
        return {
            "interval_s": self.interval_s,
            "vehicles_per_frame": round(self.vehicles, 1),
            "pairs": self.pairs,
            "matching": {"model": self.best_model, "paper": dict(self.chosen)},
            "label_rates_percent": self.rates.round(2).to_dict("records"),
            "best_method": self.best_method,
        }

    @property
    def best_method(self) -> str:
        """The method with the highest mean rate."""
        return str(self.rates.sort_values("rate", kind="stable")["method"].iloc[-1])

    @property
    def best_model(self) -> str | None:
        """The file of the retrained model if the best method scores with it, else None: the one of the program."""
        return str(self.model) if self.best_method == RETRAINED else None

    def text(self) -> str:
        """Return everything for people; the last lines can be copied into a survey file."""
        table = [f"{r.method:<22} {r.rate:6.2f}  [{r.lo:.2f}, {r.hi:.2f}]" for r in self.rates.itertuples()]
        setting = [f"    {name}: {value:g}" for name, value in self.chosen.items()]
        best = self.best_method.split(",")[0]
        model = [] if self.best_model is None else [f"  model: {self.best_model}"]
        return "\n".join(
            [
                f"simulated: {self.vehicles:.0f} vehicles a frame, {self.interval_s:g} s between frames; "
                f"{self.pairs} pairs of images judged what others had chosen",
                "",
                f"{'method':<22} right labels, % [95 % interval of the mean]",
                *table,
                "",
                "matching:" + ("" if best == "default" else f"\n  method: {best}"),
                *model,
                "  paper:",
                *setting,
            ]
        )


def calibrate(
    survey: Survey,
    *,
    scenario: Scenario | None = None,
    base: Path = Path(),
    interval_s: float | None = None,
    vehicles: float | None = None,
    pairs: int = 40,
    train: Path | None = None,
    tell: Tell = lambda message: None,
) -> Calibration:
    """Choose A, B, C of the paper's relaxation on simulated traffic like the survey's, and compare all methods there.

    *interval_s* and *vehicles* a frame are the survey's own if not given: the median interval of its archive, and the
    mean of its published detections (if there are none, the scenario's demand stays as it is). *scenario* is the place,
    by default the built-in crossing; relative paths in it are taken from *base*. *pairs* are shared out over drives of
    four seeds; two choose and two judge. With *train* the learned score is also retrained on the drives that choose,
    and written to that file. Raises ``UnusableData`` where too few vehicles were in view.
    """
    place = scenario or Scenario()
    interval_s = interval_s or _interval_s(survey)
    wanted = vehicles or _vehicles_per_frame(survey)
    drives = list(_drives(_like(place, interval_s, pairs), wanted, base, tell))
    choosing, judging = ([pair for drive in drives[side::2] for pair in drive.pairs(APART_S)] for side in (0, 1))
    params = survey.matching.model_copy(update={"model": survey.model_path})
    chosen = _chosen(choosing[:: -(-len(choosing) // MOST_SWEPT)], params, tell)
    tell(f"{len(METHODS) + 1 + (train is not None)} methods on {len(judging)} other pairs")
    rates = method_rates(judging, METHODS, params)
    paper = RelaxationParams.model_validate({**params.paper.model_dump(), **chosen})
    rates[CALIBRATED] = method_rates(judging, ["proposed"], params.model_copy(update={"paper": paper}))["proposed"]
    if train is not None:
        retrain(drives[0::2], train, params, tell)
        params = params.model_copy(update={"model": str(train)})
        rates[RETRAINED] = method_rates(judging, ["default"], params)["default"]
    seen = float(np.mean([len(pair.earlier) for pair in (*choosing, *judging)]))
    return Calibration(interval_s, seen, len(judging), chosen, _summary(100 * rates), train)


def retrain(drives: Sequence[Drive], out: Path, params: MatchingParams, tell: Tell) -> None:
    """Add trees to the model of *params* that correct it for traffic like that of *drives*, and write it to *out*.

    Every pair is looked at without a flow map and with the one that its drive's own sightings teach, as in a run.
    """
    lessons = []
    for drive in drives:
        taught = learn_flow(drive.sightings, matching=params)
        for flow_map, pair in product((None, taught if len(taught.xy) else None), drive.pairs(LESSONS_APART_S)):
            lessons.append(Lesson.of(pair, str(drive.seed), flow_map, params))
    tell(f"the score is trained on {len(lessons)} pairs")
    trained = train_model(lessons, begun=model_text(params.model))
    make_folder(out.parent)
    out.write_text(trained.text, encoding="utf-8")


def drive_once(scenario: Scenario, base: Path) -> Drive:
    """Simulate *scenario* and return what its detector saw."""
    with tempfile.TemporaryDirectory() as folder:
        simulate(scenario, Path(folder) / "drive", base=base)
        seen = pd.read_parquet(Path(folder) / "drive" / "detections.parquet")
        key = pd.read_parquet(Path(folder) / "drive" / "truth" / "detection_keys.parquet")
    # of vehicles merged into one sighting, one gives it its name
    named = key.dropna().sort_values("vehicle_id").drop_duplicates("detection_id").set_index("detection_id")
    known = seen.assign(vehicle=seen["detection_id"].map(named["vehicle_id"]))
    images = [image[COLUMNS].reset_index(drop=True) for _, image in known.groupby("t_utc")]
    images = [image.assign(detection_id=np.arange(len(image)).astype(str)) for image in images]
    return Drive(scenario.seed, seen, images, scenario.interval_s)


def _chosen(pairs: list[LabelledPair], params: MatchingParams, tell: Tell) -> dict[str, float]:
    """Return the A, B, C that serve *pairs*, by the names of their parameters."""
    default = np.array([params.paper.a_delay, params.paper.b_neighbours, params.paper.c_opposite])
    settings = np.vstack([default, paper_grid(), logarithmic_grid()])
    settings = settings[settings.sum(axis=1) > 0]
    tell(f"{len(settings)} settings of A, B, C on {len(pairs)} pairs")
    rates = []
    for number, pair in enumerate(pairs, 1):  # of busy traffic each takes a minute: people want to see it go on
        rates.append(sweep_rates([pair], settings, params)[0])
        tell(f"swept on {number} of {len(pairs)} pairs")
    row = chosen_setting(np.array(rates), settings, default)
    names = ("a_delay", "b_neighbours", "c_opposite")
    return dict(zip(names, (round(float(value), 3) for value in settings[row]), strict=True))


def _like(place: Scenario, interval_s: float, pairs: int) -> Scenario:
    """Return *place* at the interval and for the number of pairs, without pictures."""
    each = max(2, -(-pairs // DRIVES))
    step_s = interval_s * max(2, round(APART_S / interval_s))
    changes = {"interval_s": interval_s, "duration_s": (each - 1) * step_s + 2.5 * interval_s, "frames": False}
    return Scenario.model_validate({**place.model_dump(), **changes})


def _drives(scenario: Scenario, wanted: float | None, base: Path, tell: Tell) -> Iterator[Drive]:
    """Yield every drive, the demand scaled once so that about *wanted* vehicles are in view."""
    first = _driven(scenario, 0, base, tell)
    scale = _scale(first, wanted)
    if scale != 1.0:
        scenario = _busier(scenario, scale)
        first = _driven(scenario, 0, base, tell)
    yield first
    for number in range(1, DRIVES):
        yield _driven(scenario, number, base, tell)


def _driven(scenario: Scenario, number: int, base: Path, tell: Tell) -> Drive:
    tell(f"drive {number + 1} of {DRIVES}: {scenario.name}, seed {scenario.seed + number}")
    found = drive_once(scenario.model_copy(update={"seed": scenario.seed + number}), base)
    if not found.pairs(APART_S):
        raise UnusableData(
            f"no vehicle was in view of the simulated {scenario.name}: raise traffic.demand_vph or warm_up_s of the "
            "scenario, or let the camera look at its roads (centre_m)"
        )
    return found


def _scale(drive: Drive, wanted: float | None) -> float:
    if wanted is None:
        return 1.0
    ratio = wanted / float(np.mean([len(pair.earlier) for pair in drive.pairs(APART_S)]))
    return 1.0 if abs(ratio - 1) <= ALIKE else float(np.clip(ratio, 1 / MOST_SCALE, MOST_SCALE))


def _busier(scenario: Scenario, scale: float) -> Scenario:
    """Return *scenario* with its demand scaled; routes of the user's own are left as they are."""
    if scenario.routes is not None:
        return scenario
    demand = min(20000.0, scale * scenario.demand_vph)
    return scenario.model_copy(update={"traffic": scenario.traffic.model_copy(update={"demand_vph": demand})})


def _interval_s(survey: Survey) -> float:
    files = scan_archive(survey).files
    files = split_sequences(files, max_gap_s=survey.archive.max_gap_s, time_zone=survey.survey.time_zone)
    found = median_interval_s(files)
    if not found:
        raise ConfigError("the archive tells no interval between frames: give --interval-s")
    return found


def _vehicles_per_frame(survey: Survey) -> float | None:
    """Return the mean number of detections in the frames of the newest published date; None before the first run."""
    published = survey.resolve(survey.output.root) / "current" / "detections"
    dates = sorted(folder for folder in published.glob("date=*") if folder.is_dir())
    if not dates:
        return None
    rows = read_table(sorted(dates[-1].rglob("*.parquet")), TABLES["detections"], ["frame_id"])
    return len(rows) / rows["frame_id"].nunique() if len(rows) else None


def _summary(rates: pd.DataFrame) -> pd.DataFrame:
    """Return mean and 95 % interval over pairs, by resampling pairs, which are independent."""
    rng = np.random.default_rng(1)
    drawn = rng.integers(0, len(rates), (1000, len(rates)))
    means = rates.to_numpy()[drawn].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5], axis=0)
    found = {"method": list(rates.columns), "rate": rates.mean().to_numpy(), "lo": low, "hi": high}
    return pd.DataFrame(found).sort_values("rate", ascending=False, kind="stable", ignore_index=True)
