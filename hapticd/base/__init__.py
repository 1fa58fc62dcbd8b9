"""Tools for all other packages, independent of haptics: errors, YAML, clocks, files, the C core.

The core and the process:

    core               the C core as Python sees it: `ffi`, `lib`, records as numpy dtypes, enums
    clock              CLOCK_MONOTONIC and the time of day, read together
    memory             memory allocation of a process that runs for months
    threads            background threads; checks the user's limit of processes; ends a process with its parent
    steps              long work as a generator, which yields between its parts

Text that people and programs write and read:

    errors             errors that a user can cause, and their texts
    wording            numbers, counts and times as text: 12,340 ticks, 2.5 ms, 19 %
    model              the base class of validated models: strict numbers, limits, paths of faults
    arguments          arguments that a program passes to a client, checked before anything is sent
    csv_table          finds separator, names, units and numbers of a .csv
    yaml_source        reads YAML: plain data and line numbers
    yaml_text          writes YAML as the loader reads it
    html_page          an HTML page in a single file, and its tables
    codec              msgpack of plain data, and values that are encoded once and sent often
    merge_patch        JSON Merge Patch (RFC 7396)

Files and numbers:

    files              files that are written atomically, and never replace a device, a pipe or a folder
    units              units of quantities, and the unit that a column's name states
    lattice            filters as coefficients and as reflection coefficients

Questions, and where to begin:

    Where does Python call C?
        core; the functions and structs themselves are in csrc/api/.
    Where do the text and the line of a validation error come from?
        model (faults_of) takes text and path from pydantic; yaml_source (Document) has the lines.
    How is a file written atomically?
        files (write_atomically, atomic_file).
"""
