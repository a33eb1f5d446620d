"""The pictures of a result, under one roof."""

from vtrack_batch.report.canvas import background_picture
from vtrack_batch.report.frame_strip import AnnotatedFrame, frame_strip
from vtrack_batch.report.trajectory_map import trajectory_map

__all__ = ["AnnotatedFrame", "background_picture", "frame_strip", "trajectory_map"]
