"""A run over the whole frame zoo ends well: each file is used or set aside with its reason, and no worker dies."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest
import stub

import vtrack_batch as vt
from vtrack_batch.pipeline import run as run_module
from vtrack_batch.pipeline.run import Orders, run_survey

sys.path.insert(0, str(Path(__file__).parents[1] / "archive"))

from frame_zoo import ZOO, outcome

ENDINGS = ("jpg", "png", "tif")


def test_a_run_over_the_whole_zoo_ends_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = stub.stub_archive(tmp_path / "survey", 1)
    (folder / "survey.yaml").write_text(stub.SURVEY.replace("unit_s: 20", "unit_s: 300"))
    wanted = {}
    old_s = time.time() - 3600
    for number, (_, data) in enumerate(sorted(ZOO.items()), start=1):
        path = folder / "frames" / f"20260517T06{number // 60:02d}{number % 60:02d}Z.{ENDINGS[number % 3]}"
        path.write_bytes(data)
        os.utime(path, (old_s, old_s))
        wanted[path.name] = outcome(data)
    monkeypatch.setattr(run_module, "_work", stub.work)
    events: list[str] = []
    report = run_survey(
        vt.load_survey(folder / "survey.yaml"), orders=Orders(workers=1), tell=lambda event, **_: events.append(event)
    )
    assert report.exit_code == 3
    assert "died" not in events
    results = vt.open_results(folder / "results")
    frames, lost = (results[name].astype(str) for name in ("frames", "quarantine"))
    used = frames.loc[frames["status"] == "used", "path"]
    found = {**dict.fromkeys(used, "whole"), **dict(zip(lost["path"], lost["reason"], strict=True))}
    assert {name: found[name] for name in wanted} == wanted
