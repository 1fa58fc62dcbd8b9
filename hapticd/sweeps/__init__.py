"""Sweeps of simulations: studies of many points, computed on dask.

Studies and points:

    sweep             runs a study from Python and returns a DataFrame
    keys              the keys of a study's YAML file, each with its range
    study             reads and validates a study, with every fault at its line
    axes              the values of each varied key, and their combination into points
    identity          the identity of a point: a hash of everything that its result depends on
    plan              the points of a study and their identities
    point             configuration, operator and run of one point
    refine            the search for the boundary of a condition along one key
    measures/         quantities that are measured at a point
    columns           the columns of a result: name, kind, unit

    batches/          fits of all recordings of a folder tree
    participants/     many simulated participants of an experiment

Figures and pages:

    figure_keys       the keys of `figures`
    figure_faults     checks the figures of a study against its columns
    default_figures   the figures of a study without the key `figures`
    results           the rows of a result folder, and the label of each column
    axis_scales       scale, unit and ticks of an axis
    map_figure        a measured column as colors over two varied keys
    line_figure       measured columns over one varied key
    figures           draws figures as PNG files and as SVG for a page
    report_page       figures, tables and study as one HTML page

Engine:

    work              the interface of a study to the engine: points, identities, and pieces (groups of points)
    engine            sends pieces to workers, and stores the rows of each as soon as it is done
    task              the function that a worker runs on a piece
    interrupts        defers SIGINT and SIGTERM to moments without half-written results
    cluster           dask clients of local processes, local threads, or a running scheduler
    forked_workers    the fork server, a process from which local workers are forked
    preloaded         the modules that the fork server imports
    worker_check      the code version, which command and worker must share
    store             the results in a folder, as Parquet files
"""
