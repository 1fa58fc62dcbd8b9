"""Recordings: written, read, exported to other forms, and rendered again. There is one form, .npz.

Writing:

    writer          the samples and events of one recording: partial files, notes, the end, a full disk
    export          .mcap for the tools of robotics, .csv for everything else
    event_columns   events as columns, and back
    recovery        files of what killed recordings left

Reading:

    recording       `hapticd.load`: a recording as its user sees it; where one goes, and an export at its end
    reader          what a .npz holds; what is wrong in a damaged one
    missed_periods  periods without a tick, counted from samples

Rendering:

    replay          renders a recording again by the servo's own tick, and compares
    simulated       `hapticd simulate`: renders a scene and an operator into a recording

Questions, and where to begin:

    What stands in a file?
        docs/protocol.md (Files); then writer and event_columns.
    Who records a running daemon?
        client/record; the flight recorder is daemon/flight_recorder. Both write by RecordingWriter.
    Why does a replay differ from its recording?
        replay (_difference, _doubts).
"""
