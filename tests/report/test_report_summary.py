"""The page is self-contained, escaped, and says first what to doubt."""

import io
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
from PIL import Image

from vtrack_batch.report.summary import page_picture, summary_page

START = pd.Timestamp("2026-05-17T06:00Z")


class Text(HTMLParser):
    """Checks that tags close, and collects what a reader sees and what a browser would load or run."""

    VOID = frozenset(("meta", "img", "br", "link"))

    def __init__(self, page):
        super().__init__()
        self.open, self.seen, self.loads, self.tags = [], [], [], set()
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.loads += [value for name, value in attributes if name in ("src", "href", "srcset", "data")]
        assert not any(name.startswith("on") for name, _ in attributes)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.seen.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.seen))


def manifest(**changes):
    base = {"survey": "Ring road", "version": "0.1.0", "crs": "EPSG:25832", "time_zone": "Europe/Berlin"}
    return {**base, "frames": {"used": 117, "quarantined": 3}, "zones_proposed": False, **changes}


def bins(rows, columns):
    table = pd.DataFrame(rows, columns=columns)
    return table.assign(bin_start_utc=START, bin_s=900, observed_s=900.0, status="observed")


def tables():
    od_columns = ["origin", "destination", "vehicle_class", "count"]
    od_rows = [
        ("west", "east", "all", 41.0),
        ("west", "east", "car", 41.0),
        ("east", "west", "all", 7.0),
        ("west", "unknown", "all", 2.0),
    ]
    turn_rows = [
        ("J1", "west", "through", "all", 30.0),
        ("J1", "west", "left", "all", 10.0),
        ("J1", "west", "unknown", "all", 60.0),
        ("J1", "west", "left", "car", 10.0),
    ]
    speed_columns = ["place", "vehicles", "time_mean_mps", "space_mean_mps", "p50_mps", "p85_mps"]
    return {
        "od_pairs": bins(od_rows, od_columns).astype({"origin": "category", "destination": "category"}),
        "turns": bins(turn_rows, ["junction", "approach", "movement", "vehicle_class", "count"]),
        "speeds": bins(
            [("west", 10, 10.0, 9.0, 10.0, 12.0), ("west", 30, 20.0, 19.0, 20.0, 22.0), ("n", 0, *[np.nan] * 4)],
            speed_columns,
        ),
        "trajectories": pd.DataFrame({"flags": [0, 1, 5, 4, 4]}),
        "stops": pd.DataFrame({"kind": ["signal", "signal"], "duration_s": [10.0, 30.0]}),
        "coverage": bins([("west",), ("east",)], ["place"]),
        "quarantine": pd.DataFrame(
            {"path": ["b.jpg", "a.jpg", "c.jpg"], "reason": ["truncated", "truncated", "empty"], "detail": ["", "", ""]}
        ),
    }


def drawn():
    out = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (90, 2000, 3)).astype(np.uint8)).save(out, "PNG")
    return page_picture(out.getvalue())


def test_numbers_of_the_tables_are_on_the_page():
    page = Text(summary_page(manifest(), tables(), {"main map": drawn()}))
    assert "2026-05-17 08:00 to 2026-05-17 08:15 (Europe/Berlin), " in page.text
    assert "used 117" in page.text
    assert "truncated 2 a.jpg" in page.text
    assert "all 5 implausible speed 2 faster, or accelerating" in page.text
    assert "bridged gap 3 holds points" in page.text
    assert "east 7 7" in page.text
    assert "west 41 2 43" in page.text
    assert "J1 west left 10 25% 40" in page.text  # of the turns that are known
    assert "J1 west unknown 60 – 240" in page.text
    assert "west 40 63.0 59.4 63.0 70.2" in page.text
    assert "signal 2 20 30" in page.text


def test_nothing_is_loaded_and_nothing_runs():
    page = summary_page(manifest(), tables(), {"map": drawn()})
    parsed = Text(page)
    assert "default-src 'none'" in page
    assert not parsed.tags & {"script", "link", "iframe", "object", "form", "base"}
    assert parsed.loads
    assert all(load.startswith("data:image/jpeg;base64,") for load in parsed.loads)
    assert "http://" not in page
    assert "https://" not in page


def test_pictures_are_shrunk_for_the_page():
    with Image.open(io.BytesIO(drawn())) as shown:
        assert (shown.format, shown.size) == ("JPEG", (1600, 72))
    assert len(summary_page(manifest(), {}, {"map": drawn()})) < 400_000


def test_names_cannot_become_markup():
    evil = "<script>alert(1)</script>"
    found = tables()
    found["quarantine"] = found["quarantine"].assign(path=evil, reason=evil)
    found["od_pairs"] = found["od_pairs"].astype({"origin": object}).replace({"origin": {"west": evil}})
    found["speeds"] = found["speeds"].assign(place=evil)
    page = summary_page(manifest(survey=evil + "$title ${x}", crs=evil), found, {evil: drawn()})
    assert "<script" not in page
    assert "$title ${x}" in Text(page).text


def test_warnings_come_first_and_only_when_due():
    quiet = Text(summary_page(manifest(), tables(), {})).text
    assert "proposed" not in quiet
    assert "could not be used" not in quiet
    loud = summary_page(manifest(frames={"used": 50, "quarantined": 50}, zones_proposed=True), tables(), {})
    assert loud.index("No zones were given") < loud.index("<h2>")
    assert "50 of 100 frames could not be used" in loud


def test_empty_result_still_has_a_page():
    page = Text(summary_page({}, {}, {})).text
    assert "No frame could be used" in page
    empty = {name: table.iloc[:0] for name, table in tables().items()}
    assert Text(summary_page(manifest(), empty, {})).text


def test_same_input_same_page():
    assert summary_page(manifest(), tables(), {"b": drawn(), "a": drawn()}) == summary_page(
        manifest(), {name: table.iloc[::-1] for name, table in tables().items()}, {"a": drawn(), "b": drawn()}
    )
