"""What do the tracks tell of the detections they were made from?

Temporal integration after Badenas, Sanchiz and Pla ("Using Temporal Integration for Tracking Regions in Traffic
Monitoring Sequences"): segmentation feeds tracking, and what tracking knows mends the segmentation. Here it is one step
with tables on both sides, and no loop: detection, tracking, revision, tracking.

1. ``parts``: boxes that drive so close behind one another that no driver would are parts of one vehicle; one box around
   all of them takes their place.
2. ``ghosts``: things that lie still while vehicles drive through them are holes in a wrong background; they go.
3. ``stands``: while a vehicle stands, its size and place are its own: sightings that are off are held (flag HELD).
4. ``absences``: a vehicle that stopped, was lost, and drove on from the same spot stood there all the while; a frame
   that missed a vehicle between two that did not shows it between them. Such sightings are added for the second
   tracking and withdrawn again (``withdraw``), so that no table holds a detection that nobody made.
5. ``withdraw.queued``: what never moves and lies where others drive is queued, not parked.

In: the tables of one sequence. Cost: a fraction of that of tracking; what counts is the second tracking.
"""
