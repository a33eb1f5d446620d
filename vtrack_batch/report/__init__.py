"""What does a person judge a result by?

Pictures of each sequence, and one page that says what was found, what was not, and what to doubt.

In     pixels of a few frames, their maps to the ground, and the tables of a result
Out    PNG and JPEG as bytes, HTML as text; nothing is read from or written to disk

    trajectory_map      reference frame, trajectories coloured by speed, zones and gates   ``trajectory_map``
    frame_strip         frames side by side: oriented boxes, numbers of their vehicles     ``frame_strip``
    background_picture  the background that vehicles were found against                    ``canvas``
    page_picture        one of these as the page shows it: a smaller JPEG                  ``summary``
    summary_page        one page: warnings first, then OD pairs, turns, speeds, coverage   ``summary``

The pictures show the tables as they are, not the detector's inner state: what looks wrong here is wrong there. Colours
(viridis; Okabe and Ito 2008) can be told apart by the colour-blind. The page loads nothing from the network and forbids
scripts; all text from files and tables is escaped. Same input, same bytes.

Cost: a second or two a picture, whatever the size of the frames.
"""
