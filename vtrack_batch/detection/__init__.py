"""Detection: where are vehicles in each frame, how large, how do they lie, what colour is their paint?

In: the pixels of a frame, its homography to the block's reference frame, the block's ``Background``. Out: rows of table
``detections`` (without ids and times, which the pipeline knows).

Steps

1. ``candidates.find_candidates``, frame by frame: fine frames are reduced to about 0.3 m; ``background.subtract`` says
   how surely every pixel differs from the ground and which pixels are only darkened by a cast shadow;
   ``background.faint`` fills bodies of nearly the ground's colour by what nine pixels show alike; ``seeds`` says where
   to look, ``lanes``, learned from some samples of the block, in which directions; ``boxes`` fits oriented boxes, car
   to lorry, drawn once a block by ``templates``; ``overlaps`` drops boxes made of what a better one left over;
   ``measure`` takes colour, area and contrast from inside. Weak candidates are kept with their score.
2. ``place.learn_place``, once a block: ``chains`` of strict candidates that move steadily along their own axis, fast or
   for long, or, where frames are far apart, fitting closely, draw the road; over ground of one hue, for roofs have
   another.
3. ``place.select``: on the road weak candidates count as well; elsewhere only members of chains, and strict ones if
   most strict ones lie on the road (else they are roofs). No frame is decoded twice. With too few chains (few frames,
   no traffic) strict candidates count everywhere. ``again.seen_again``: where the frames before and after show a
   vehicle that was due in between, still weaker candidates count.
4. ``standing.find_standing``, once a block, by what the moving vehicles look like (``examples``, ``appearance``,
   ``scan``, ``plausible``): vehicles in the background itself; ``standing.with_standing`` adds them to the frames in
   which nothing else lies on their place, with flag IN_BACKGROUND.
5. ``ground.measure_on_ground``: one matrix per frame takes centres and axes to metres; frames are never resampled.

A box is scored by evidence inside, minus evidence just outside, plus the cast shadow on the far side from the sun. The
best box takes its pixels and its shadow, then the next is found; this splits queues without a watershed and keeps cars
whole that a windscreen cuts.

Assumptions: vehicles are 4 to 18 m long and 2 m wide; the ground is nearly a plane and frames are registered to about
half a metre; roofs may drift by parallax, but slower than 1.5 m/s or not straight. What never moves is found only near
the road, if it looks like a car and stands on ground of the road's hue. A shadow lies beside what casts it.

Source: design after measurements on KIT AIS frames and rendered archives; oriented matched filters after greedy pursuit
(Mallat and Zhang 1993); two rounds, so that the road sorts out what one frame cannot.

Cost: a frame with 40 vehicles per megapixel takes about as long as decoding it 4 times, over half of it in the boxes;
the place model takes about a second for 10 000 candidates; memory about 9 bytes per pixel of one frame.
"""
