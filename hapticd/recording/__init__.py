"""Recordings: writing, reading, export to other formats, and replay. The format of recordings is .npz.

Writing:

    writer          writes a recording into partial files, and finishes it, also on a full disk
    export          exports to .mcap for robotics tools, and to .csv for other programs
    event_columns   converts events to columns, and back
    recovery        finishes recordings whose process was killed

Reading:

    recording       `hapticd.load` and the class Recording; opens the files of a new recording
    reader          reads a .npz, and reports the fault of a damaged file
    missed_periods  counts periods without a tick from samples

Rendering:

    replay          renders a recording again by the servo's tick, and compares the forces
    simulated       `hapticd simulate`: renders a scene and an operator into a recording

Questions, and where to begin:

    What does a file hold?
        docs/reference/recordings.md; then writer and event_columns.
    Which modules record a running daemon?
        client/record and daemon/flight_recorder. Both use RecordingWriter.
    Why does a replay differ from its recording?
        replay (_difference, _doubts).
"""
