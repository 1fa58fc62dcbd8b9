"""Recordings: writing, reading, export to other formats, and replay. Their own format is .npz.

Writing:

    writer          writes the samples and events of a recording: partial files, notes, the end, a full disk
    export          .mcap for the tools of robotics, .csv for everything else
    event_columns   converts events to columns, and back
    recovery        completes the files of recordings that were killed

Reading:

    recording       `hapticd.load`: a recording as its user sees it; its path, and the export at its end
    reader          reads a .npz, and reports what is wrong in a damaged one
    missed_periods  counts periods without a tick from samples

Rendering:

    replay          renders a recording again with the servo's tick, and compares
    simulated       `hapticd simulate`: renders a scene and an operator into a recording

Questions, and where to begin:

    What does a file hold?
        docs/protocol.md (Files); then writer and event_columns.
    What records a running daemon?
        client/record; the flight recorder is daemon/flight_recorder. Both write by RecordingWriter.
    Why does a replay differ from its recording?
        replay (_difference, _doubts).
"""
