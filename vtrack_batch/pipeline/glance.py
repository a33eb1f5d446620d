"""Whether results are up to date, told from the record of the last run and the names in the archive alone.

This module loads nothing slow: it is what `status` starts with.
"""

from __future__ import annotations

import re
from pathlib import Path

from vtrack_batch.archive.walk import listing_of
from vtrack_batch.errors import NoArchive
from vtrack_batch.pipeline.record import Record, file_hash, read_record
from vtrack_batch.storage.output import Output

_ROOT = re.compile(r"^output:[^\n]*?(?:\n[ \t#][^\n]*|\n)*?[\s{,]root:[ \t]*[\"']?([^\"'\n,}#]+)", re.MULTILINE)
DEFAULT_ROOT = "results"


def glance(survey_yaml: Path, out: Path | None = None) -> Record | None:
    """Return the record of the last run if nothing changed since; None if that must be looked into.

    The survey file is not read but recognised: the record must have been made from just this file.
    """
    output = Output(out if out is not None else _root(survey_yaml))
    record = read_record(output)
    if record is None or record.survey_file is None or record.survey_file != file_hash(survey_yaml):
        return None
    if any(file_hash(Path(path)) != sha256 for path, sha256 in record.named_files.items()):
        return None
    if not record.results_stand(output) or output.is_distrusted() or record.listing is None:
        return None
    try:
        return record if listing_of(Path(record.archive), settle_s=record.settle_s) == record.listing else None
    except NoArchive:
        return None


def _root(survey_yaml: Path) -> Path:
    try:
        found = _ROOT.search(survey_yaml.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        found = None
    return survey_yaml.parent / (found[1].strip() if found else DEFAULT_ROOT)
