"""How many of the vehicles that were there does the detector find?

Vehicles whose places are known are painted into copies of an archive's own frames, and the detector is asked again.

1. ``motion``: who stands and who surely moves, told from successive frames without tracking.
2. ``donors``: moving vehicles with nothing near are cut out, box, windscreen and shadow, at the background's exposure.
3. ``injection``: where they are painted. Half of those that stand are painted over for their whole stay, so that the
   painted one may become background as a real one does; some that move are painted over in their place, so that
   neighbours are as near as they really are; others are put on free road where somebody drives at another time.
4. ``sightings``: a painted vehicle has come back if a box that belongs to nothing else lies on it.
5. ``estimate``: n vehicles found of a kind of which a share r comes back stand for n / r that were there; moving and
   standing ones apart, by place and time, with intervals that count one stay as one witness.

Assumptions: paint does not depend on the place; those that are found are like those that are not, but for paint and
place. What nobody is ever found of - a vehicle that stands all through the archive, a lane below trees - is not told:
completeness is of the vehicles that the detector could find.

Source: injection and recovery, as surveys of faint things measure what they miss; weights of Horvitz and Thompson
(1952); interval of Wilson (1927).

Cost: a copy of a unit's samples is decoded, painted, learned from and detected in, as much as the first pass and the
second pass of so many frames; a copy holds some hundreds of vehicles. Memory as the first pass.
"""
