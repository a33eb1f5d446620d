"""Who is who in the next image?

Two tables of vehicles seen at two moments go in (place, and colour if there is one); links between them come out, with
a probability each, and those that disappeared or appeared. No history; a flow map of the place helps, if there is one.

1. ``candidates``: partners lie in a box as wide as the speed limit allows; a sparse list of edges.
2. ``colour``: the paper's initial probabilities (eq. 7-11), or a likelihood ratio: how alike are two paints, given how
   common that paint is here, and how much paints vary between these two images (learned from the surest links).
3. ``relaxation``: the paper's methods (a) original, (b) colour, (c) opposite, (d) proposed, as printed, eq. 15-24.
4. ``neighbours``: the method ``untrained``. The motion of vehicles of the same stream is the prior of a displacement;
   evidence keeps its weight through all rounds, where the printed relaxation forgets it.
5. ``flow``: a flow map of the place, if one was learned, replaces the prior of displacements.
6. ``features``, ``score``: the default. What Bayes' rule, neighbours and the map say about a link, turned into a
   calibrated probability by trees trained on simulated traffic (``models``).
7. ``decision``: argmax, mutual choice, or the best one-to-one set.
8. ``match``: puts these together.

Source: T. Fuse and E. Shimizu, "A New Technique for Vehicle Tracking on the Assumption of Stratospheric Platforms"; S.
T. Barnard and W. B. Thompson, "Disparity Analysis of Images", IEEE PAMI 2 (1980). The reach D and the tolerance T of
the paper are pixels at 1.5 s; here they are speeds times the interval, with a least value for the noise of positions.

Assumptions: coordinates are metres on flat ground; vehicles beside one another on one stream move alike; detections are
at most one per vehicle. Cost: vehicles x candidates x neighbours of the same stream; 50 vehicles a few milliseconds.
"""
