"""How good is a result? Measured against a truth, with intervals.

Question
    Are the vehicles of each frame seen, followed under one name, and counted, timed and sent to the right places?

In
    A published snapshot (``load.load_result``) and a truth (``load.load_truth``): the tables that ``simulate`` writes,
    a rendered archive (``truth.csv``, ``parked.csv``, ``poses.csv``), or a KIT sequence (``tracks.csv``,
    ``vehicles.csv``, ``ignore.csv``).

Out
    ``evaluate.Evaluation``: nested plain numbers for JSON, and a page of text. Every score has a 95 % interval.

Steps
    1. ``frames``: frames of the truth are found in the result, by exact time, or by the number in the file name. A
       frame that the run quarantined counts, with all its vehicles missed.
    2. ``pairing``: in each frame, sightings and true vehicles are matched one to one within a gate: 5 px, or, with true
       boxes, half the vehicle's length. What lies on a parked car, in an ignored box, or within 12 px of the border is
       neither right nor wrong. Where the truth holds parked vehicles too (KIT), movers are scored apart, with tracks
       whose ends lie more than 2.5 m apart.
    3. Scores: ``detection`` (precision, recall, F1, error of the centre, strata), ``links`` (consecutive frames, pooled
       label rate), ``tracks`` (IDF1, MOTA, HOTA, end to end), ``traffic`` (OD pairs, GEH, turns), ``speeds``.
    4. ``blocks``: intervals by drawing blocks of time, never vehicles. OD pairs and turns are drawn by bin.

Source
    Hungarian method (Kuhn 1955); CLEAR MOT (Bernardin and Stiefelhagen 2008); IDF1 (Ristani and others 2016); HOTA
    (Luiten and others 2021), in TrackEval's order of work; block bootstrap (Künsch 1989); GEH (DMRB 12.2.1).

Assumptions
    Positions are pixels of the frame as stored, so that errors of registration do not enter detection. One truth holds
    no two frames of the same time. A place that the run proposed is taken for the true place at which most of its
    vehicles really start or end.

Cost
    One neighbour search over all sightings, then sums: about a second for 80 frames of 190 vehicles, most of it draws.
"""
