"""Where on the ground does the reference frame lie?

In: what the survey knows (`GeoreferenceParams`): ground sampling distance with origin and rotation, control points, a
world file, or the tags of a GeoTIFF. Out: one homography reference px -> ground metres per block (`GroundFix`; a row of
the table ``references``), and pictures laid on a common grid (`GroundGrid`, `orthorectify`).

Conventions
    (0, 0) is the centre of the top-left pixel. GeoTIFF and ``origin`` speak of the outer corner of that pixel, half a
    pixel further out, unless a GeoTIFF is tagged PixelIsPoint; world files speak of its centre. Ground x is right
    or east, y up or north, in metres of a projected CRS or of a local frame with its origin at the frame's corner.

Steps
    1. `fix.find_fix` chooses the source; each source has a function of its own beside it.
    2. Control points: least squares, affine from 3, homography from 4 where it predicts left-out points better,
       blunders left out from 6 on (least median of squares, Rousseeuw 1984).
    3. Another CRS than the survey's: a 9 x 9 grid of points is transformed by PROJ and a homography fitted, the
       residual of which is reported (a millimetre for a frame of a kilometre).

Assumptions
    Only points are transformed, so nothing is lost by resampling. Degrees and feet are refused for computing, with a
    suggestion what to set. A GeoTIFF frame's own tags are believed for the reference frame only; other frames
    are placed by registration, which is far finer.

Cost
    Microseconds per reference; `orthorectify` about 10 ms per megapixel.
"""
