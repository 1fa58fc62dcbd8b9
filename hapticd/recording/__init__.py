"""Recordings: their three formats written and read, and rendered again.

Writing:

    writer          what the formats share: partial files, notes, the end, a full disk
    npz_writer      the samples and events as an archive of numpy
    csv_writer      one row a tick
    mcap_writer     for the tools of robotics
    mcap_format     what an .mcap file holds, for its writer and its reader
    formats         chooses the format by the ending of the file
    event_columns   events as columns, and back
    recovery        files of what killed recordings left

Reading:

    recording       `hapticd.load`: a recording as its user sees it
    reader          chooses the reader by the ending of the file
    npz_reader      reads .npz
    csv_reader      reads .csv and the two files beside it
    event_cells     events from the cells of a .csv, column by column
    mcap_reader     reads .mcap from the first record to the last
    reading_limits  how much memory a file may take, and what is wrong in it
    missed_periods  periods without a tick, counted from samples

Rendering:

    replay          renders a recording again by the servo's own tick, and compares
    simulated       `hapticd simulate`: renders a scene and an operator into a recording

Questions, and where to begin:

    What stands in a file?
        docs/protocol.md (Files); then the writer of the format.
    Who records a running daemon?
        client/record; the flight recorder is daemon/flight_recorder. Both write by formats (open_writer).
    Why does a replay differ from its recording?
        replay (_difference, _doubts).
"""
