"""Background: what does the ground look like without traffic, and how far may a frame differ from it by chance?

In: up to some dozens of frames of one block with their homographies to the block's reference frame. Out: one frozen
``Background`` in reference pixels: the empty ground, a tolerance per pixel, which ground was seen, and what
shadows do to colours here.

Steps of ``learn.learn_background``

1. ``exposure``: every sample is brought to the reference's exposure, first by a monotone map per channel, then by a
   smooth gain (drifting cloud shade). Both rest on medians over flat ground, so vehicles do not steer them.
2. ``stacks``, ``planes``: samples are warped once, strip by strip, and their exact temporal median is taken by a pruned
   sorting network of byte-wise minima and maxima. Ground that a sample does not cover votes for neither side.
3. ``mode``: where a place is occupied so often that the median is doubtful (stop lines), samples vote for colours: calm
   ones more, because vehicles have edges, and those that look like the trafficked ground nearby. What most samples
   show before and after something as dark as a shadow lies below it.
4. Tolerance: a share of the local range of grey levels (a frame is never registered perfectly) plus the spread over
   time that most samples show (trees, water, roofs seen from another side); where vehicles stand for long, that the
   samples of free ground show.
5. ``shadow``: the ratio by which cast shadows darken the ground, and on which side of a vehicle they lie.

The future is allowed: samples spread over the whole block beat every running background, because a queue that stands
for a minute is background to a short memory. Two signal cycles should lie within the samples.

``subtract`` is the difference of one frame from the background; chapter ``detection`` uses the same function, so that
what is learned here is what is used there. It looks at one pixel of nine, and at all of them where those differ.
``faint`` then asks the pixels around what was found again, nine together, as far as empty ground of the frame shows
little by chance.

Sources: median by sorting network, Knuth, The Art of Computer Programming 3, 5.2.2, algorithm M; mode by votes,
Parzen 1962; smoothing of the exposure map, Eilers 2003; shadows as constant ratios, Horprasert et al. 1999.

Cost: a sample takes as long as decoding it 12 times; memory about 20 bytes per pixel of the result, and a few rows of
every sample: where samples are kept is the caller's choice.
"""
