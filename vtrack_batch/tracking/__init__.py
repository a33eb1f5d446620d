"""What path did each vehicle drive?

All detections of a sequence go in; trajectories, smoothed track points and matches come out.

1. ``sightings``: detections in order of time and place, among all frames of the sequence, with the footprint of each.
2. ``edges``: which sighting can be the next of which. Between successive frames by the matching chapter, without
   history; over misses, where a vehicle is headed or where it came from.
3. ``beliefs``: every possible link carries the state of a vehicle that came that way (constant velocity, real time
   steps, mean colour). A link's odds mix the ways into it and the ways out of it: past and future both speak.
4. ``link``: the best set of chains is one sparse assignment over the whole sequence, links over misses and breaks
   included. The spread of colours is learned from the sequence's own surest links.
   ``ends``: end links that no brake or engine allows are cut.
5. ``paths``: Rauch-Tung-Striebel smoothing, one point for each frame between first and last sighting.
6. ``tables``: state, heading, class by size, reasons for start and end, flags.
7. ``identity``: link probabilities that mean what they say, and with them how sure a path is one vehicle.
8. ``pairs``: for comparison, chains of plain pair matches.

Because an archive is processed afterwards, a vehicle's future helps to tell where it began: birth, the weak point of
trackers at 0.25-1 Hz, is no special case.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), chapters 6, 8;
Rauch, Tung and Striebel (1965); minimum-cost path cover as in Zhang, Li and Nevatia, "Global Data Association for
Multi-Object Tracking Using Network Flows", CVPR 2008.

Assumptions: at most one detection per vehicle and frame; a vehicle may stay unseen for ``coast_s`` or ``coast_frames``.
``identity_probability`` is that of a path's weakest link, calibrated on simulated traffic; null for methods that are
not. Cost: linear in frames.
"""
