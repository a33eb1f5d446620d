"""Frames that workers died of, remembered by path and content: they are set aside until they are tried again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import pandas as pd

from vtrack_batch.storage.durable import replace_durable
from vtrack_batch.storage.output import Output


@dataclass(frozen=True)
class Culprit:
    """A frame that two workers died of."""

    path: str
    reason: str
    detail: str


@dataclass(frozen=True)
class Culprits:
    """Path → sha256, reason, detail; the same path with another content is another frame."""

    known: Mapping[str, Mapping[str, str]]

    def sifted(self, files: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Return *files* (path, sha256) without the culprits, and these as path, reason, detail."""
        rows = []
        if self.known:
            for path, sha256 in files.loc[files["path"].isin(list(self.known)), ["path", "sha256"]].itertuples(
                index=False
            ):
                about = self.known[path]
                if about["sha256"] == sha256:
                    rows.append((path, about["reason"], about["detail"]))
        fatal = pd.DataFrame(rows, columns=["path", "reason", "detail"], dtype=object)
        if fatal.empty:
            return files, fatal
        return files[~files["path"].isin(fatal["path"])].reset_index(drop=True), fatal


def read_culprits(output: Output) -> Culprits:
    """Return the remembered culprits."""
    try:
        return Culprits(dict(json.loads((output.state / _NAME).read_bytes())))
    except (OSError, ValueError):
        return Culprits({})


def remember(output: Output, culprits: Iterable[Culprit], frames: pd.DataFrame) -> None:
    """Remember *culprits* with the content that they have in *frames*."""
    sha256 = frames.set_index("path")["sha256"]
    found = {c.path: {"sha256": str(sha256[c.path]), "reason": c.reason, "detail": c.detail} for c in culprits}
    _write(output, {**read_culprits(output).known, **found})


def forget(output: Output, paths: Iterable[str]) -> list[str]:
    """Forget those of *paths* that are remembered; returns them."""
    known = read_culprits(output).known
    gone = sorted(set(paths) & set(known))
    if gone:
        _write(output, {path: about for path, about in known.items() if path not in gone})
    return gone


_NAME = "culprits.json"


def _write(output: Output, known: Mapping[str, Mapping[str, str]]) -> None:
    replace_durable(output.state / _NAME, json.dumps(known, sort_keys=True, indent=1) + "\n")
