"""Why a piece of work is due: which frames came, went or changed, which parameters have another value than before."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError, StorageError
from vtrack_batch.pipeline.carry import published_parts
from vtrack_batch.pipeline.parts import read
from vtrack_batch.pipeline.plan import Piece, date_of
from vtrack_batch.pipeline.prepare import Due, Prepared, prepare
from vtrack_batch.storage.output import Output

MOST_NAMED = 5


@dataclass(frozen=True)
class Explanation:
    """Why one piece is due, in one sentence and in particulars; not due if there is no reason."""

    step: str
    piece: str
    reason: str
    particulars: tuple[str, ...]


def explain(survey: Survey, what: str | None = None) -> list[Explanation]:
    """Return why pieces are due, or, for the piece, sequence, date or frame *what*, what holds for it.

    Raises ``ConfigError`` where *what* is none of these.
    """
    prepared = prepare(survey)
    due = {due.piece.key: due for due in prepared.due}
    pieces = [piece for piece in prepared.plan.pieces() if _concerns(piece, what)]
    if what is None:
        pieces = [piece for piece in pieces if piece.key in due]
    elif not pieces:
        lost = prepared.index.quarantine
        rows = lost.loc[lost["path"] == what]
        if rows.empty:
            raise ConfigError(
                f"{what!r} is no piece of work, sequence, date or frame of this survey; `explain` without it lists all "
                "that is due"
            )
        row = rows.iloc[0]
        return [Explanation("index", what, f"set aside: {row['reason']}", (str(row["detail"]),))]
    changes = tuple(changed_parameters(prepared)) if due else ()
    former = published_parts(prepared.context.output)
    return [_explained(piece, due.get(piece.key), prepared.context.output, former, changes) for piece in pieces]


def changed_parameters(prepared: Prepared) -> Iterator[str]:
    """Yield ``section.key: before → now`` for every parameter that differs from the published snapshot's."""
    manifest = prepared.context.output.current_manifest()
    before = dict(_flat((manifest or {}).get("parameters", {})))
    now = dict(_flat(prepared.context.survey.model_dump(mode="json")))
    for name in sorted(before.keys() & now.keys()):
        if before[name] != now[name]:
            yield f"{name}: {before[name]} → {now[name]}"


def _concerns(piece: Piece, what: str | None) -> bool:
    if what is None or what in (piece.name, date_of(piece)) or piece.name.split(" ")[0] == what:
        return True
    return piece.unit is not None and any(ref.path == what for ref in piece.unit.frames)


def _explained(
    piece: Piece, due: Due | None, output: Output, former: Mapping[str, Mapping[str, str]], changes: tuple[str, ...]
) -> Explanation:
    if due is None:
        return Explanation(piece.step, piece.name, "done", ())
    particulars: list[str] = []
    if "frames" in due.reason and piece.unit is not None:
        particulars += _changed_frames(piece, output, former[piece.step].get(piece.name))
    sections = [name for name in piece.ingredients if name in due.reason]
    particulars += [text for text in changes if any(text.startswith(f"{name}.") for name in sections)]
    return Explanation(piece.step, piece.name, due.reason, tuple(particulars))


def _changed_frames(piece: Piece, output: Output, key: str | None) -> Iterator[str]:
    """Yield which frames of a unit came, went or changed since its part *key* was made."""
    assert piece.unit is not None
    try:
        part = output.part(piece.step, key) if key else None
    except StorageError:
        return
    if part is None:
        return
    table = read([part], "frames")
    before = dict(zip(table["path"].astype(str), table["sha256"].astype(str), strict=True))
    now = {ref.path: ref.sha256 for ref in piece.unit.frames}
    groups = {
        "new": sorted(now.keys() - before.keys()),
        "gone": sorted(before.keys() - now.keys()),
        "changed": sorted(path for path in now.keys() & before.keys() if now[path] != before[path]),
    }
    for word, paths in groups.items():
        if paths:
            more = f" and {len(paths) - MOST_NAMED} more" if len(paths) > MOST_NAMED else ""
            yield f"{word}: {', '.join(paths[:MOST_NAMED])}{more}"
    if not any(groups.values()):
        yield "its neighbours changed, which serve its background, or the first frames of its sequence"


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    else:
        yield name, value
