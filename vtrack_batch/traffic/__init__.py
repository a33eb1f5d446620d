"""Traffic: from trajectories to what planners ask for.

**Question.** Given where every vehicle was at every frame, what the frames showed, and the places that somebody cares
about: how many went from where to where, how did they turn, how fast, how dense, where did they stand, and which of the
zeros are mere ignorance?

**In.** ``trajectories`` and ``track_points`` (as declared in ``model.tables``), zones (``model.zones``), the frames'
times and footprints (``model.views``), the survey's time zone.
**Out.** ``trajectories`` with origin, destination and movement, and the tables ``crossings``, ``od_pairs``, ``turns``,
``speeds``, ``flows``, ``stops``, ``coverage``.

**Steps.** ``measure.measure`` does all of it:

1. ``paths``: track points become straight segments; those that entered or left the view are prolonged by one frame
   interval to find the zone just ahead, and all are split at the borders of the time bins (``bins``: wall clock of the
   survey, 92 or 100 quarter-hours when the clocks change).
2. ``places``: zones become lines to cross (with an inward side) and areas to be in (with a length along the road);
   ``junctions`` names the movement between each two arms by their bearings from the junction's centre.
3. ``coverage``: which share of each place each moment showed. It turns counts into rates, and zeros into nulls where
   nothing was in view.
4. ``crossings`` of lines and ``visits`` to areas, both exact for straight segments. Wavering at a border by less than
   ``hysteresis_m`` is none.
5. The tables: ``od`` (each trajectory has one origin and one destination, so totals balance), ``turns``, ``speeds``
   (time mean, space mean, percentiles), ``flows`` (Edie 1963), ``stops``.

``zones`` reads and writes GeoJSON. ``propose`` finds zones where none are drawn: ends of trajectories at the border of
the view, clustered.

**Doubt.** Where trajectories carry ``identity_probability``, counts by identity (OD pairs, turns) are expected numbers
with exact 95 % intervals (Poisson-binomial), and the missing mass goes to ``unknown``; without it they are plain
numbers without interval. Shares carry Wilson's interval. Counts over a gate need no identity and have none.

**Assumptions.** Straight, steady motion between track points. A frame speaks for its footprint until the next frame of
its sequence, at most ``max_gap_s``. Parked vehicles are no traffic. One junction for all proposed arms.

**Cost.** Vectorised over points and segments: two million track points, 60 000 frames and ten places take about 15 s on
one core, two thirds of it for footprints that all differ.
"""
