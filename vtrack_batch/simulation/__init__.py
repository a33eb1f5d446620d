"""What would a perfect observer have seen? Traffic with known truth, and the frames in which to look for it.

In: a `Scenario` (params.py). Out, below one folder (write.py, the only module that touches files)

    frames/         JPEG, or GeoTIFF when an orthophoto is the ground; names give the time in UTC
    truth/          detections, track_points, trajectories, crossings, od_pairs, turns as Parquet with the columns of
                    `model.tables` (detections also vehicle_id, standing_s, luminance); poses.csv, parked.csv
    zones.geojson   a gate across each arm, an approach area on each arm of the crossing
    survey.yaml     ready for `vtrack-batch run`
    scenario.json   what all of it was made from

Steps
    1. `network`: routes through a four-leg crossing (copied from a SUMO net) or along a street; `fleet`: who drives.
    2. `traffic`: the Intelligent Driver Model (Treiber, Hennecke, Helbing 2000, Phys. Rev. E 62, 1805) past a
       fixed-time signal of four groups; green waits until the box is clear, so that streams never collide.
    3. `flight`: drift, jitter, rotation and perspective of the platform, exposure; `stage`: the geometry of all this.
    4. `ground` (`roads`, `town`, `canvas`): a procedural town, drawn once, larger and finer than a frame.
    5. `render`, `paint`: per frame the ground is warped by the pose, vehicles and their shadows are painted in frame
       space with 25 sub-samples a pixel, then come cloud shade, exposure, blur and noise.
    6. `truth`, `counts`, `zones`: the tables, restricted to what is in view.

What the truth calls known
    A vehicle is in a frame when its centre is. Its origin is known when it crossed its arm's gate inwards between the
    first and the last frame, its destination when it crossed one outwards; else they are ``unknown``. A turn is
    entered where the centre leaves the approach area, and known where it reaches another one within the archive.
    Places are exact centres (half-way between the axles, which ride on the route), speeds the derivative of that
    place. Colours are the paint as painted, before shadow, cloud and exposure. Ids are random and carry no order.

Assumptions
    The ground is flat and seen straight down: no parallax, no swaying trees, no pedestrians or cyclists. Vehicles keep
    their lane; buses do not turn. Shadows fall on the ground, not on other vehicles. Frames on an orthophoto move by
    pure translation, so that their geotransforms are exact.

Cost
    One core: 10 s for the ground of an HD frame, 0.2 s a frame, 1 s for five minutes of traffic. The same
    scenario gives the same bytes on the same machine, whatever the number of workers.
"""
