"""Vehicle trajectories, OD pairs, turn rates and speeds from archives of time-stamped aerial frames.

The public names below are imported on first use, so that starting up stays fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vtrack_batch.config.load import load_survey
    from vtrack_batch.errors import VtrackError
    from vtrack_batch.matching.flow import FlowMap
    from vtrack_batch.matching.match import match
    from vtrack_batch.model.tables import TABLES
    from vtrack_batch.pipeline.run import run_survey
    from vtrack_batch.storage.results import open_results
    from vtrack_batch.tracking.learn import learn_flow
    from vtrack_batch.tracking.track import track

__version__ = "0.1.0"
__all__ = [
    "TABLES", "FlowMap", "VtrackError", "__version__", "learn_flow", "load_survey", "match", "open_results",
    "run_survey", "track",
]  # fmt: skip

_HOME = {
    "FlowMap": "vtrack_batch.matching.flow",
    "TABLES": "vtrack_batch.model.tables",
    "VtrackError": "vtrack_batch.errors",
    "learn_flow": "vtrack_batch.tracking.learn",
    "load_survey": "vtrack_batch.config.load",
    "match": "vtrack_batch.matching.match",
    "open_results": "vtrack_batch.storage.results",
    "run_survey": "vtrack_batch.pipeline.run",
    "track": "vtrack_batch.tracking.track",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'vtrack_batch' has no attribute {name!r}")
