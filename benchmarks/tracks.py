"""Does a track stay with its vehicle: ours and the peers on pinned, own and real sequences. ``make bench-tracks``.

Writes the section ``tracks`` of docs/accuracy.md and docs/performance.md, and docs/figures/tracks*.svg.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import product

import pandas as pd

from benchmarks import targets
from benchmarks.environment import pinned
from benchmarks.figures import bars
from benchmarks.jobs import called, parallel, quick
from benchmarks.matching import setting_text
from benchmarks.methods import OURS, PEERS, Index, flow_map, run_on, track_ours
from benchmarks.page import ACCURACY, FIGURES, PERFORMANCE, markdown_table, stamp, write_section
from benchmarks.traffic import labelled_sequence
from benchmarks.tuning import idf1, joined, training_sequences, tuned, with_settings
from benchmarks.work import (
    identity,
    kit_boxes,
    mean_and_half_width,
    movement_scores,
    pinned_sequences,
    sequences_as_sightings,
    skysat,
    songdo,
    step_rates,
)

CELLS = {
    "crossing": ((1.5, 0.1), (1.5, 0.2), (2.5, 0.1), (4.0, 0.1)),
    "congested": ((1.5, 0.1),),
    "grid": ((1.5, 0.1),),
}
OWN = {"crossing": range(201, 211), "congested": range(211, 216), "grid": range(216, 221)}
SECONDS = {"crossing": 300, "congested": 300, "grid": 120}
REAL = {"Songdo": (songdo, (0.5, 1.0)), "SkySat": (skysat, (0.5, 1.0)), "KIT boxes": (kit_boxes, (0.5,))}
DRAWS, TUNING_DRAWS = range(8), range(100, 104)
BORDER_MPS = 20.0
PINNED, OTHERS = "pinned", "own seeds"
SCORES = ("idf1", "whole", "od_error", "turn_error", "geh", "links")
COMMAND = "make bench-tracks"


@dataclass(frozen=True)
class Extent:
    """How much is run: own sequences a scene, seconds of archive for maps, draws of real traffic, tuning of peers.

    Of our methods, those named *ours* are run, on own sequences those of *own_of*; peers so too unless it names some.
    """

    own: int
    map_s: float
    draws: int
    tuning_share: float
    limit_s: float
    ours: tuple[str, ...] = ()
    own_of: tuple[str, ...] = ()
    peers_on: tuple[str, ...] = tuple(CELLS)

    def own_with(self, method: str) -> int:
        """Return how many own sequences of a scene *method* is run on."""
        return self.own if not self.own_of or method in self.own_of else 0


FULL = Extent(own=10, map_s=1e9, draws=8, tuning_share=1.0, limit_s=60)
QUICK = Extent(
    own=5, map_s=1e9, draws=3, tuning_share=0.4, limit_s=2,
    ours=("default, flow map", "default", "untrained", "paper's (d) proposed"),
    own_of=("default, flow map", "default"), peers_on=("crossing", "congested"),
)  # fmt: skip


def main() -> None:
    """Measure everything, print the tables, write the sections."""
    few = quick()
    extent = QUICK if few else FULL
    chosen = [n for n, ours in enumerate(OURS) if not extent.ours or ours.name in extent.ours]
    jobs = [
        (ours_on, (scene, interval_s, number, extent))
        for scene, interval_s in dict.fromkeys((scene, s) for scene, cells in CELLS.items() for s, _ in cells)
        for number in chosen
    ]
    jobs += [(peer_on, (scene, number, extent)) for number in range(len(PEERS)) for scene in extent.peers_on]
    # no archive, no flow map
    numbers = [n for n in chosen if not OURS[n].mapped] + [len(OURS) + n for n in range(len(PEERS))]
    real = [(real_on, (place, number, extent)) for place, number in product(REAL, numbers)]
    answers = parallel(jobs + real)
    simulated = pd.concat([rows for rows, _ in answers[: len(jobs)]], ignore_index=True)
    filmed = pd.concat([rows for rows, _ in answers[len(jobs) :]], ignore_index=True)
    notes = [note for _, note in answers if note is not None]
    accuracy, performance = report(simulated, filmed, notes, few)
    write_section(ACCURACY, "tracks", accuracy)
    write_section(PERFORMANCE, "tracks", performance)
    print(accuracy, performance, sep="\n\n", file=sys.stdout)


def ours_on(scene: str, interval_s: float, number: int, extent: Extent) -> tuple[pd.DataFrame, None]:
    """Return the scores of one of our methods on the sequences of a scene at an interval."""
    ours = OURS[number]
    learned = flow_map(scene, interval_s, extent.map_s) if ours.mapped else None
    rows, cells = work(scene, tuple(cell for cell in CELLS[scene] if cell[0] == interval_s), extent.own_with(ours.name))
    track, seconds = track_ours(ours, rows, learned)
    return scores(rows, track, seconds).assign(method=ours.name).join(cells, on="sequence"), None


def peer_on(scene: str, number: int, extent: Extent) -> tuple[pd.DataFrame, tuple]:
    """Return the scores of a peer, tuned on another seed, on the sequences of a scene; and what it was tuned to."""
    peer = PEERS[number]
    best = tuned(
        peer, training_sequences(scene, CELLS[scene], extent.tuning_share), peer.tracks, idf1, limit_s=extent.limit_s
    )
    rows, cells = work(scene, CELLS[scene], extent.own_with(peer.name))
    (track,), seconds = run_on(peer, with_settings(rows, best), peer.tracks)
    answer = scores(rows, track, seconds.set_index("sequence")["seconds"].to_dict())
    return answer.assign(method=peer.name).join(cells, on="sequence"), (peer.name, scene, best)


def real_on(place: str, number: int, extent: Extent) -> tuple[pd.DataFrame, tuple | None]:
    """Return label rates between successive frames of real traffic without colour, by interval and draw."""
    seen, intervals_s = REAL[place]
    rows = joined([seen(s, draw) for s, draw in product(intervals_s, DRAWS[: extent.draws])])
    note = None
    if number < len(OURS):
        name = OURS[number].name
        track, _ = track_ours(OURS[number], rows, None)
    else:
        peer = PEERS[number - len(OURS)]
        name = peer.name
        training = joined([seen(s, draw) for s, draw in product(intervals_s, TUNING_DRAWS[: extent.draws])])
        best = tuned(peer, training, peer.tracks, _draw_rates, limit_s=extent.limit_s)
        (track,), _ = run_on(peer, with_settings(rows, best), peer.tracks)
        note = (name, place, best)
    interval_s = rows.groupby("sequence")["interval_s"].first()
    rates = _draw_rates(rows, track).rename("rate").rename_axis("sequence").reset_index()
    return rates.assign(interval_s=rates["sequence"].map(interval_s), method=name, place=place), note


def work(scene: str, cells: tuple[tuple[float, float], ...], own: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return sequences, and by ``sequence`` the cell of each: ``scene, interval_s, missed, source``."""
    tables, kinds = [], []
    for interval_s, missed in cells:
        tables.append(pinned_sequences(scene, interval_s, missed))
        length = {"driven_s": SECONDS[scene], "seconds": SECONDS[scene]}
        made = [labelled_sequence(scene, seed, interval_s, missed, **length) for seed in OWN[scene][:own]]
        tables += [sequences_as_sightings(pd.concat(made, ignore_index=True))] if made else []
        kinds += [(scene, interval_s, missed, source) for source in (PINNED, OTHERS)[: 1 + bool(made)]]
    rows = joined(tables)
    sequence = rows["sequence"].drop_duplicates()
    of = pd.DataFrame([kinds[n] for n in sequence // 1_000_000], columns=["scene", "interval_s", "missed", "source"])
    return rows, of.set_index(sequence.to_numpy())


def scores(rows: pd.DataFrame, track: Index, seconds: dict[int, float]) -> pd.DataFrame:
    """Return the scores (0-1) of every sequence, with seconds and number of frames."""
    found = []
    for name, of in rows.groupby("sequence"):
        codes = track[of.index]
        of = of.reset_index(drop=True)
        row = {"sequence": name, "frames": of["frame"].max() + 1, "seconds": seconds.get(name, float("nan"))}
        row |= identity(of["truth"].to_numpy(), codes)
        row |= movement_scores(of, codes, max(20.0, BORDER_MPS * of["interval_s"][0]))
        found.append(row | {"links": step_rates(of, codes)["rate"].mean()})
    return pd.DataFrame(found)


def _draw_rates(rows: pd.DataFrame, track: Index) -> pd.Series:
    """Return the mean pooled label rate of each sequence."""
    return step_rates(rows, track).groupby("sequence")["rate"].mean()


def report(simulated: pd.DataFrame, filmed: pd.DataFrame, notes: list[tuple], few: bool) -> tuple[str, str]:
    """Return the sections of both pages."""
    lines = ["## Tracks", QUICK_TEXT + TEXT if few else TEXT]
    for source in (PINNED, OTHERS):
        of = simulated[simulated["source"] == source]
        cells = ["scene", "interval_s", "missed"]
        number = of.groupby([*cells, "method"])["sequence"].nunique().groupby(cells).max()
        lines.append(f"### {'Pinned sequences' if source == PINNED else 'Other seeds of the same scenes'}")
        if of.empty:
            lines.append("(none in this run)")
        for (scene, interval_s, missed), cell in of.groupby(["scene", "interval_s", "missed"]):
            count = number[(scene, interval_s, missed)]
            head = f"**{scene}, {interval_s} s, {100 * missed:.0f} % missed** ({count} sequences)"
            lines += [head, cell_table(cell, (scene, interval_s, missed))]
    _draw_figures(simulated, filmed)
    lines += ["![IDF1 by method](figures/tracks.svg)", "### Real traffic, no colour", REAL_TEXT, real_table(filmed)]
    lines += ["![label rates on real traffic](figures/tracks-real.svg)"]
    lines += ["### What peers were tuned to", tuned_table(notes)]
    line = stamp(called(COMMAND), peers=sorted({pinned(peer.environment) for peer in PEERS}))
    speed = ["## Sequences", SPEED_TEXT, speed_table(simulated), line]
    return "\n\n".join([*lines, line]), "\n\n".join(speed)


QUICK_TEXT = """\
**QUICK: four of our methods, own sequences by the default with and without flow map, peers
tuned on 36 s, with settings that need at most
two seconds for it, and not run on the grid, where some need many minutes.** """
TEXT = """\
`vt.track` and the peers on whole sequences. IDF1: vehicles against tracks, one to one. End to end: share of vehicles
(of four sightings and more) whose every sighting is on one track that holds nothing else. Both are counted as
`../shared/checks/score_tracks.py` counts them. OD error: Σ|found − true| / Σ true over the movements between sides of
the view, of tracks with both ends near the border (20 m/s times the interval). Turns: mean error of turn shares, in
points. GEH: share of movements with GEH below 2 of hourly flows (coarse: one vehicle in five minutes is twelve an
hour). Links: label rate between successive frames. All in %; ± half of the 95 % interval over sequences, where there
are more than two. Our pair matchers, and peers without memory, chain frame to frame. Peers: best IDF1 of a grid, for
each scene and interval, on a further seed of the same scene; ours: one set of defaults; flow maps from the unlabelled
archive."""
REAL_TEXT = """\
Label rate between successive frames, pooled over both, by `track`; 10 % dropped, 0.3 m jitter, no colour, no flow
map: Songdo (a junction, 5 s, 132 vehicles at once), SkySat (satellite video, 23 s, 39 at once), and the boxes of KIT
MunichStreet02 (10 s, 37 at once; rates of the vehicles that move 5 m and more, the others are there too). ± over draws
of what is dropped, jitter and first frame: noise of the detector, not of traffic. Peers were tuned by truth on further
draws of the *same* vehicles, which is in their favour."""
SPEED_TEXT = """\
Processor time for a pinned sequence (crossing: 200 frames, 50 vehicles each; congested: 200, 67; grid: 80, 262), 1.5 s,
10 % missed, one thread, and in brackets how many times as long our default takes."""


def cell_table(cell: pd.DataFrame, key: tuple[str, float, float]) -> str:
    """Return the scores of all methods in one cell."""
    rows = []
    turns = targets.TURNS.get(key, ((None, None), (None, None)))
    for name, wanted, turn in zip(("*must*", "*aim*"), targets.TRACKS[key], turns, strict=True):
        rows.append([name, *("–" if value is None else f"{value:g}" for value in (*wanted, *turn)), "–"])
    crossing = key[0] == "crossing"
    for method, of in cell.groupby("method", sort=False):
        shown = [number(of[s]) if crossing or s in ("idf1", "whole", "links") else "–" for s in SCORES]
        rows.append([str(method), *shown])
    return markdown_table(["method", "IDF1", "end to end", "OD error", "turns", "GEH < 2", "links"], rows)


def real_table(filmed: pd.DataFrame) -> str:
    """Return label rates on real traffic, with errors over those of the best peer."""
    columns = [(place, s) for place, (_, intervals_s) in REAL.items() for s in intervals_s]
    rates = filmed.groupby(["method", "place", "interval_s"])["rate"].mean()
    best = {c: max(rates[(peer.name, *c)] for peer in PEERS) for c in columns}
    rows = [[n, *(str(targets.REAL[c][i]) for c in columns)] for i, n in enumerate(("*must*", "*aim*"))]
    for method, of in filmed.groupby("method", sort=False):
        cells = []
        for c in columns:
            values = of[(of["place"] == c[0]) & (of["interval_s"] == c[1])]["rate"]
            cells.append(f"{number(values)} ({(1 - values.mean()) / (1 - best[c]):.2f})")
        rows.append([str(method), *cells])
    table = markdown_table(["method", *(f"{place} {s} s" for place, s in columns)], rows)
    return table + "\n\nIn brackets: errors over those of the best peer."


def tuned_table(notes: list[tuple]) -> str:
    """Return the chosen settings."""
    tracks = {peer.name: peer.tracks for peer in PEERS}
    rows = [
        [name, place, "; ".join(f"{s} s: {setting_text(tracks[name][n])}" for s, n in best.items())]
        for name, place, best in notes
    ]
    return markdown_table(["peer", "scene", "settings"], rows)


def speed_table(simulated: pd.DataFrame) -> str:
    """Return seconds for a sequence, and ratios."""
    at = simulated[(simulated["source"] == PINNED) & (simulated["interval_s"] == 1.5) & (simulated["missed"] == 0.1)]
    seconds = at.groupby(["method", "scene"], sort=False)["seconds"].mean().unstack("scene")[list(CELLS)]
    base = seconds.loc["default"]
    rows = [
        [str(method), *("–" if pd.isna(s) else f"{s:.2f} s ({base[scene] / s:.1f})" for scene, s in of.items())]
        for method, of in seconds.iterrows()
    ]
    return markdown_table(["method", *CELLS], rows)


def number(values: pd.Series) -> str:
    """Return a mean in %, with its half width where there are more than two values."""
    mean, half = mean_and_half_width(100 * values)
    return f"{mean:.1f}±{half:.1f}" if len(values) > 2 else f"{mean:.1f}"


def _draw_figures(simulated: pd.DataFrame, filmed: pd.DataFrame) -> None:
    names = simulated["scene"] + " " + simulated["interval_s"].map("{:g} s".format)
    names += simulated["missed"].map(" {:.0%}".format)
    order = [m.name for m in (*OURS, *PEERS)]
    _draw(simulated.assign(group=names, value=simulated["idf1"]), order, "IDF1, %, all seeds", "tracks.svg")
    names = filmed["place"] + " " + filmed["interval_s"].map("{:g} s".format)
    _draw(filmed.assign(group=names, value=filmed["rate"]), order, "label rate, %", "tracks-real.svg")


def _draw(table: pd.DataFrame, order: list[str], title: str, file: str) -> None:
    grouped = table.groupby(["group", "method"], sort=False)["value"]
    mean, half = (grouped.agg(lambda v, n=n: mean_and_half_width(100 * v)[n]).unstack("method") for n in (0, 1))
    bars(mean, half, title, FIGURES / file, order=order)


if __name__ == "__main__":
    main()
