"""How good is a result? Measured against a truth, with intervals.

Question
    Are the vehicles of each frame seen, followed under one name, and counted, timed and sent to the right places?

In
    A result (``load.load_result``): a published snapshot, tables of ``track`` or ``match``, or a tracker's boxes. A
    truth (``load.load_truth``): tables of ``simulate``, another result, a rendered archive, a KIT sequence, boxes of
    MOTChallenge or SkySat, geo-trax's CSV, or a table of detections that names the true vehicle of each.

Out
    ``evaluate.Evaluation``: nested plain numbers for JSON, a page of text, a page of Markdown. Every score has a 95 %
    interval. docs/measures.md defines each in two lines.

Steps
    1. ``layouts`` bring each truth into one form (``sides.Truth``). ``frames``: frames of the truth are found in the
       result, by exact time, or by the number in the file name. A frame that the run quarantined counts, with all its
       vehicles missed.
    2. ``scene``, ``pairing``: in each frame, sightings and true vehicles are matched one to one within a gate: 5 px,
       or, with true boxes, half the vehicle's length; on the ground where one side knows no pixels; by id where the
       result was made of the truth's own detections. What lies on a parked car, in an ignored box, or within 12 px of
       the border is neither right nor wrong. Where the truth holds parked vehicles too (KIT), movers are scored apart,
       with tracks whose ends lie more than 2.5 m apart.
    3. Scores: ``detection`` (precision, recall, F1, error of the centre, strata), ``links`` (of tracks, over
       consecutive frames), ``matches`` (label rates, links of the table itself), ``tracks`` (IDF1, HOTA, end to end),
       ``clear`` (MOTA), ``traffic`` (OD pairs, turns, GEH), ``speeds``.
    4. What the result says of its own doubts: ``calibration`` of probabilities, ``intervals`` of counts, sigma of
       speeds.
    5. ``blocks``: intervals by drawing blocks of time, never vehicles. ``bins``: OD pairs and turns are drawn by bin,
       or by parts of bins where there are few.

Source
    Hungarian method (Kuhn 1955); CLEAR MOT (Bernardin and Stiefelhagen 2008); IDF1 (Ristani and others 2016); HOTA
    (Luiten and others 2021), in TrackEval's order of work; block bootstrap (Künsch 1989); GEH (DMRB 12.2.1); expected
    calibration error (Naeini and others 2015).

Assumptions
    Where both sides know pixels of the frame as stored, those are compared, so that errors of registration do not enter
    detection. One truth holds no two frames of the same time. A place that the run proposed is taken for the true place
    at which most of its vehicles really start or end.

Cost
    One neighbour search over all sightings, then sums: about four seconds for 80 frames of 190 vehicles, most of it
    draws and the command's start.
"""
