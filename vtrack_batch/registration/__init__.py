"""Where does each frame lie on its block's reference frame?

In: the pixels of a frame, (H, W, 3) uint8 RGB, and the digest of a reference frame (`prepare_reference`).
Out: a homography frame px -> reference px with its residual, accepted or refused with a reason (`register`); one row
of the table ``registrations`` each. Points go through the homography; frames are resampled where they bend, else never.

Steps
    1. Guess. Both frames are reduced to about 0.13 megapixels and levelled in contrast. A shift by phase correlation
       (Kuglin & Hines 1975) starts pyramidal optical flow (Lucas & Kanade 1981; Bouguet 2001) of some corners.
    2. Mend. Small full-resolution patches of the reference are looked for where the guess puts them, by normalised
       cross-correlation with a parabola at the peak (Tian & Huhns 1986): first a few of them widely, then all narrowly.
    3. Fit. An affine map and a homography by sampling consensus (MAGSAC++, Barath et al. 2020) to the few patches, by
       reweighted least squares to all. The one that better predicts patches kept out of the fit is taken.
    4. Judge. Accepted where the robust residual at the held-out patches is small, enough of the patches that should
       be in view are found there, and they are spread over the overlap. Else features (ORB, Rublee et al. 2011), which
       survive any rotation, give another guess; else the frame is refused, never guessed at.
    5. Settle. After some frames of the block, the third of the patches that holds still best in each part of the frame
       is kept, the poses of those frames are fitted anew to them (`steady_patches`), and all others are laid on these
       patches alone.
    6. Straighten, where no plane poses fit the block: a smooth dense flow (DIS, Kroeger et al. 2016) from the median of
       its frames tells where each of them bends (`find_bend`), and that is taken out (`straighten`).

Assumptions
    The ground is nearly a plane. Roofs and trees lean away with parallax and moving vehicles move: both are outvoted as
    long as they hold less than about 60 % of the patches, and then left out: at no other height than the ground's do so
    many patches agree with each other in every frame. Shares of inliers as low as a quarter are normal on real city
    scenes, so the gate is the residual, not the share. Every frame is laid on the reference directly, never on its
    neighbour, hence errors do not add up and the order of work does not matter: the same pixels give the same matrix,
    to the bit (sums over patches are of whole numbers, sampling is seeded).

Cost
    Less than 5 % of the pixels are touched beyond a thin reduced picture: 1920 x 1080 takes about as long as decoding
    it, 48 megapixels three times that. Straightening, where needed, looks at all of them:
    about four times as long as decoding.
"""
