"""Studies of many points on dask: sweeps of simulations.

What is computed:

    sweep             a sweep from Python: a DataFrame
    keys              the keys of a study's YAML file, each with its range
    study             reads a study, with every fault at its line
    axes              the values of what is varied, and which of them make a point
    identity          by what a point is known: a hash of all that it computes
    plan              the points of a study, in pieces
    point             configuration, operator and run of one point
    refine            the boundary of a condition along one key
    measures/         what is measured of a point
    columns           the columns of a result: name, kind, unit

    batches/          batches of fits: a tree of recordings, a folder for each material
    participants/     many simulated participants of an experiment

What is shown:

    figure_keys       the keys of `figures`
    figure_faults     what is wrong between the figures of a study and its columns
    default_figures   the figures of a study that names none
    results           the rows of a folder, with words for their columns
    axis_scales       how the values of a column lie on an axis
    map_figure        a measured column as a color over two varied keys
    line_figure       measured columns over one varied key
    figures           what each figure draws, as PNG and for a page
    report_page       figures, tables and study as one HTML page

How:

    work              what the engine is given: points that are known by their identity, in pieces
    engine            sends pieces to workers, and keeps each as soon as it is done
    task              what a worker is sent
    interrupts        SIGINT and SIGTERM, where nothing is half done
    cluster           where workers are: processes, threads, or a scheduler that runs
    forked_workers    the process that workers of this machine are forked from
    preloaded         what that process imports
    worker_check      whether a worker runs the same hapticd
    store             results in a folder, as Parquet
"""
