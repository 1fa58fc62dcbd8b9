"""Psychophysical experiments: studies, sessions and their analysis.

Design of a study:

    keys              the keys of a study's YAML file, each with its range
    plain_values      pydantic types that accept YAML values unchanged
    key_paths         changes of a configuration by the paths of its keys
    study             reads a study, and reports every fault with its line
    faults            conflicts between the keys of a study
    display_faults    invalid configurations of stimuli, at the keys that cause them
    stimuli           the configuration of a stimulus
    cells             which sets of stimuli a study presents, how often, and what answer is correct
    order             random, blocked and Latin square orders, and balanced sides
    plan              the trials of one session
    check             what the device can display, the duration of a session, and the power
    power             the statistical power of a study, by simulation

Procedures and analysis:

    procedures/       choose the level of each trial
    analysis/         statistics of answers
    behaviour         rows of answers, from the folders of sessions
    published         results of publications
    published_tables  published results as tables
    results           tables and pictures of an analysis, as plain numbers
    answer_sections   sections on correct and incorrect answers
    measure_sections  sections on psychometric functions, ratings, rankings and measures of the motion
    analyze           the complete analysis of sessions
    report            the report as a page

Running a session:

    session           begins or resumes a session
    session_folder    the folder of a session
    session_log       the log of a session: each record is on disk before the session continues
    progress          the progress of a session, from its log
    runner            runs the trials of a plan
    event_codes       numbers of events for other programs
    lsl               samples and event codes as outlets of Lab Streaming Layer
    trial_scenes      the configurations of a trial, and the surfaces that a participant sees
    stage             the interface of a stage, which renders trials
    daemon_stage      a stage on a daemon, in real time
    offline_stage     a stage by hapticd.simulate, without a daemon
    front             the interface of a front: what participant and experimenter see and do
    text_front        a front at a terminal
    pages/            a front in the browser: participant's page and experimenter's page
    replies           converts typed texts and slider values to answers
    participants/     simulated participants: how they move, what they feel, how they judge
    measures          overtravel, peak force, time and path from telemetry
    bids              tables of answers and events that follow BIDS
"""
