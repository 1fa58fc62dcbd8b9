"""What everything else stands on, and what knows nothing of haptics: errors, YAML, clocks, files, the C core.

The core and the process:

    core               the C core as Python sees it: `ffi`, `lib`, records as numpy dtypes, enums
    clock              CLOCK_MONOTONIC and the time of day, read together
    memory             how a process that runs for months takes its memory
    threads            work in a thread; whether threads can be started under the user's limit of processes
    steps              work that pauses between its parts

What people and programs write, and what they read:

    errors             errors that a user can cause, and the words that report them
    wording            numbers, counts and times as text: 12,340 ticks, 2.5 ms, 19 %
    model              what every validated model shares: strict numbers, limits, places of faults
    arguments          arguments that a program passes to a client, checked before anything is sent
    yaml_source        YAML in: plain data and line numbers
    yaml_text          YAML out, as the loader reads it
    html_page          one HTML page without any other file: its frame and its tables
    codec              msgpack of plain data, and values that are encoded once and sent often
    merge_patch        JSON Merge Patch (RFC 7396)

Files and numbers:

    files              files that appear whole or not at all, and never replace a device, a pipe or a folder
    lattice            filters as coefficients and as reflection coefficients

Questions, and where to begin:

    Where does Python call C?
        core; the functions and structs themselves are in csrc/api/.
    Where does a validation error get its words and its line?
        model (faults_of) has pydantic's words and the place; yaml_source (Document) knows the lines.
    How does a file appear whole or not at all?
        files (write_whole, whole_file).
"""
