"""From a survey file to published tables: what is due, doing it, publishing it.

===========  ==========================  ==============================================================================
step         piece of work               what it makes
===========  ==========================  ==============================================================================
``index``    the survey                  frames with their times, sequences, content hashes; what cannot be used
``detect``   unit (clock-aligned piece)  registrations, references, detections, the ground picture
``track``    sequence of a local date    matches, trajectories, track_points
``traffic``  local date                  crossings, od_pairs, turns, speeds, flows, stops, coverage
``picture``  sequence of a local date    the pictures of the report and the ground mosaic
``publish``  the survey                  one snapshot
===========  ==========================  ==============================================================================

``plan.py`` decides (purely) which pieces are due, by keys made from content hashes, the parameters that the step reads
and the step's algorithm version; ``execute.py`` carries them out with any number of processes; ``run.py`` ties it
together. Each step's file is: read, call the chapters, write.
"""
