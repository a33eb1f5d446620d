"""Looking after a result folder: gc, verify, repair, and frames that are to be tried again."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError, StorageError, UnusableFrame
from vtrack_batch.pipeline.culprits import forget, read_culprits
from vtrack_batch.pipeline.plan import Piece
from vtrack_batch.pipeline.record import drop_record, read_record
from vtrack_batch.storage.collect import LEAST_HOURS, Rubbish, find_rubbish, remove
from vtrack_batch.storage.output import Output
from vtrack_batch.storage.verify import Damage, check_parts, check_snapshot

MAY_PASS = (
    "io_error", "permission", "changed_while_running", "changed_while_reading", "file_missing",
    "worker_died", "timeout", "out_of_memory",
)  # fmt: skip
"""Reasons that lie with the machine rather than the frame."""


def output_of(survey: Survey) -> Output:
    """Return the result folder of *survey*; raises ``ConfigError`` where there is none yet."""
    output = Output(survey.resolve(survey.output.root))
    if not output.state.is_dir():
        raise ConfigError(f"{output.root}: no results here yet; `vtrack-batch run` makes them")
    return output


def collect(survey: Survey, *, keep_hours: float = LEAST_HOURS, dry_run: bool = False, wait_s: float = 0.0) -> Rubbish:
    """Remove superseded snapshots and parts that no snapshot names; returns what went, or would go."""
    output = output_of(survey)
    if dry_run:
        return find_rubbish(output, _recorded(output), keep_hours=keep_hours)
    with output.locked(wait_s):
        rubbish = find_rubbish(output, _recorded(output), keep_hours=keep_hours)
        try:
            remove(rubbish)
        except OSError as problem:
            raise StorageError(f"{output.root}: cannot be cleared ({problem}); what is published is intact") from None
        return rubbish


def verify(survey: Survey, *, data: bool = False, inputs: bool = False) -> list[Damage]:
    """Return what differs from what was written: in the published snapshot, in all parts, in the archive's frames."""
    output = output_of(survey)
    if not output.current.is_symlink():
        raise ConfigError(f"{output.root}: nothing is published yet; `vtrack-batch run` does that")
    found = list(check_snapshot(output.current.resolve()))
    if data:
        found += [damage for _, _, damage in check_parts(output)]
    if inputs:
        found += _changed_inputs(survey, output)
    return found


def _recorded(output: Output) -> dict[str, Collection[str]]:
    record = read_record(output)
    return dict(record.parts) if record else {}


def _changed_inputs(survey: Survey, output: Output) -> Iterable[Damage]:
    """Yield frames whose content changed although size and time did not: nobody wrote them, so the disk did."""
    from vtrack_batch.archive.read import content_hash, read_bytes
    from vtrack_batch.pipeline.index import scan_archive
    from vtrack_batch.storage.hashes import FileStore

    store = FileStore(output.state / "files.sqlite")
    try:
        files = scan_archive(survey, known=store).files
    finally:
        store.close()
    root = survey.resolve(survey.archive.root)
    known = files.loc[files["sha256"].notna(), ["path", "sha256"]]
    for path, sha256 in known.itertuples(index=False):
        try:
            if content_hash(read_bytes(root, path)) != sha256:
                yield Damage(
                    path, "has another content than when it was first read, though its size and time are the same"
                )
        except UnusableFrame as problem:
            yield Damage(path, f"cannot be read any more ({problem})")


@dataclass(frozen=True)
class Repaired:
    """What `repair` did: parts that it dropped, as step/key, and whether the published snapshot is damaged."""

    dropped: tuple[str, ...]
    snapshot_damaged: bool


def repair(survey: Survey, *, wait_s: float = 0.0) -> Repaired:
    """Drop what is damaged and all that was remembered, so that the next run makes it anew.

    Half-written staging goes; parts that are not what was written go, to be made again; remembered hashes and the
    record of the last run go, since they follow from the archive and the parts. The published snapshot stays, even
    damaged, until the next run publishes a whole one.
    """
    output = output_of(survey)
    with output.locked(wait_s):
        damaged = sorted({(step, key) for step, key, _ in check_parts(output)})
        for step, key in damaged:
            output.drop_part(step, key)
        drop_record(output)
        (output.state / "files.sqlite").unlink(missing_ok=True)
        published = output.current.resolve()
        snapshot_damaged = published.is_dir() and any(True for _ in check_snapshot(published))
        if snapshot_damaged:
            output.distrust()
        return Repaired(tuple(f"{step}/{key}" for step, key in damaged), snapshot_damaged)


def retry(survey: Survey, paths: Collection[str] = (), *, wait_s: float = 0.0) -> list[str]:
    """Make frames due again that were set aside for what may have passed; returns their paths.

    *paths*: these frames whatever the reason; none = all whose reason lies with the machine.
    """
    from vtrack_batch.pipeline.prepare import prepare
    from vtrack_batch.storage.results import open_results

    output = output_of(survey)
    with output.locked(wait_s):
        table = open_results(output.root)["quarantine"]
        chosen = table["path"].isin(list(paths)) if paths else table["reason"].astype(str).isin(MAY_PASS)
        wanted = sorted({*table.loc[chosen, "path"], *(path for path in paths if path in read_culprits(output).known)})
        unknown = sorted(set(paths) - set(wanted))
        if unknown:
            raise ConfigError(f"not in quarantine: {', '.join(unknown)}; `vtrack-batch quarantine list` shows what is")
        forget(output, wanted)
        plan = prepare(survey).plan
        concerned = [piece for piece in plan.detect if _holds(piece, set(wanted))]
        for piece in plan.followers(concerned):
            output.drop_part(piece.step, piece.key)
        drop_record(output)
        return wanted


def _holds(piece: Piece, paths: Collection[str]) -> bool:
    return piece.unit is not None and any(ref.path in paths for ref in piece.unit.frames)
