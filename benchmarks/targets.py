"""What is asked for, beside which results are printed: label rates in %, nothing / 10 % missed, by interval."""

PAIRS = {
    "road": (
        ((99.5, 99.2), (99.0, 98.8), (97.0, 97.0), (93.5, 93.5)),
        ((99.8, 99.5), (99.3, 99.3), (98.0, 98.0), (95.0, 95.5)),
    ),
    "congested": (
        ((99.8, 99.5), (99.5, 99.0), (99.0, 98.5), (96.5, 96.0)),
        ((99.9, 99.8), (99.8, 99.5), (99.5, 99.3), (98.0, 97.5)),
    ),
    "crossing": (
        ((99.0, 99.0), (97.8, 97.2), (97.0, 96.5), (95.0, 94.0)),
        ((99.3, 99.3), (98.3, 98.0), (98.0, 97.8), (96.5, 95.5)),
    ),
    "grid": (
        ((99.0, 99.0), (97.5, 97.2), (96.0, 95.5), (93.0, 92.5)),
        ((99.3, 99.2), (98.3, 98.2), (97.0, 96.6), (94.4, 94.1)),
    ),
}
UNTRAINED = {  # no map, 1.5 s, 10 % missed
    "must": {"road": 97.5, "congested": 97, "crossing": 88, "grid": 89.5},
    "aim": {"road": 98, "congested": 98, "crossing": 92, "grid": 93},
}
ROBUST = {
    "must": {
        (s, v): r for s, r in (("road", 96.5), ("crossing", 95.5)) for v in ("colour noise × 3", "position noise 3 px")
    },
    "aim": {
        (s, v): r for s, r in (("road", 97.5), ("crossing", 97)) for v in ("colour noise × 3", "position noise 3 px")
    },
}
TRACKS = {  # scene, interval, missed -> must and aim of IDF1 %, end to end %, OD error %
    ("crossing", 1.5, 0.1): ((99.0, 95, 3), (99.5, 97, 2)),
    ("crossing", 1.5, 0.2): ((97.5, 88, 7), (98.5, 93, 3)),
    ("crossing", 2.5, 0.1): ((97.5, 88, 7), (98.5, 93, 4)),
    ("crossing", 4.0, 0.1): ((93, 75, 15), (97, 85, 8)),
    ("congested", 1.5, 0.1): ((99.3, 96, None), (99.7, 98, None)),
    ("grid", 1.5, 0.1): ((98, 90, None), (99, 94, None)),
}
TURNS = {("crossing", 1.5, 0.1): ((3, 90), (1, 95))}  # must and aim of turn shares, points, and GEH < 2, %
REAL = {  # label rate by track without colour: must, aim
    ("Songdo", 0.5): (95, 98),
    ("Songdo", 1.0): (80, 92),
    ("SkySat", 0.5): (93, 97),
    ("SkySat", 1.0): (80, 90),
    ("KIT boxes", 0.5): (98, 98),
}
