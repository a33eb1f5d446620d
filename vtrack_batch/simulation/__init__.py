"""What would a perfect observer have seen? Traffic with known truth, and the frames in which to look for it.

In: a `Scenario` (params.py): a built-in scene or the user's own SUMO network and routes. Out, below one folder

    frames/             JPEG, or GeoTIFF when an orthophoto is the ground; names give the time in UTC
    detections.parquet  what a detector would have seen: noise, shadow, clustered misses, false alarms, merges; shuffled
    truth/              frames, detections, track_points, trajectories, crossings, od_pairs, turns, speeds, flows,
                        queues as Parquet with the columns of `model.tables` (detections also vehicle_id, standing_s,
                        luminance, visible_share, shadow_share); detection_keys: whose each detection is;
                        vehicles: what SUMO calls them; others: pedestrians and trams; poses.csv, parked.csv
    sumo/               network, routes, SUMO's own trips and loop detectors below the gates; day-2, ...: of later days
    zones.geojson       a gate where each road leaves the view, an approach area on each arm of each junction
    survey.yaml         ready for `vtrack-batch run`
    scenario.json       what all of it was made from

Steps
    1. `scenes`: the built-in networks in SUMO's plain terms; `fleet`: who drives, and when; `sumo`: netconvert and the
       simulator (Eclipse SUMO, extra `[sim]`): steps of 0.1 s, ballistic update, changes of lane that take their time;
       `driving` ties these together.
    2. `roadnet`: the network as lanes and junctions; `places`: its gates and arms in view, whatever the network.
    3. `traffic`: SUMO's samples of front bumpers become centres at the frames, and moments of passing lines.
    4. `flight`: drift, jitter, rotation and perspective of the platform, exposure; `stage`: the geometry of all this.
    5. `scenery` (`ground`, `roads`, `marks`, `town`, `standing`, `walkers`, ...): what the traffic drives through.
    6. `render`, `paint`: frames.
    7. `truth`, `counts`, `stays`, `queues`, `zones`: the tables, restricted to what is in view; `detector`.
    `write` is the rim: it and `sumo` touch files.

What the truth calls known
    A vehicle is in a frame when its centre is. Its origin is known when it crossed a gate inwards between the first and
    the last frame and no other before, its destination when the last gate it crossed was outwards; else they are
    ``unknown``. A turn is entered where the centre crosses the border between arm and junction, and known where it
    next crosses another one within the archive. Places are centres, half a length behind the front bumper; moments of
    passing a line are interpolated between samples at most 0.5 s apart by a cubic. Colours are the paint as painted,
    before shadow, cloud and exposure. Ids are random and carry no order. A queue is two or more vehicles below 5 km/h
    on the edge that leads to an arm, the first within 25 m of the junction, no gap above 15 m.

Assumptions
    SUMO's vehicles are points on lanes: on tight bends the centre is off the path by the sagitta of half the vehicle,
    and in junctions bodies may touch. Bicycles and motorcycles of a user's routes count as cars, trams as buses.
    Frames on an orthophoto move by pure translation, so that their geotransforms are exact.

Cost
    One core: five minutes of a busy crossing take SUMO 2 s, a city of 8,000 vehicles about as long as it lasts. The
    same scenario gives the same bytes on the same machine and version of SUMO, whatever the number of workers.
"""
