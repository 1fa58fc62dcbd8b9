"""Psychophysical experiments: studies, sessions and their analysis.

Design of a study:

    keys              the keys of a study's YAML file, each with its range
    plain_values      pydantic types that accept YAML values unchanged
    key_paths         changes of a configuration by the paths of its keys
    study             reads a study, and reports every fault with its line
    faults            conflicts between the keys of a study
    display_faults    why the configuration of a study's stimuli is invalid
    stimuli           a stimulus as a scene: the base configuration and what is changed in it
    cells             which sets of stimuli a study presents, how often, and what answer is correct
    order             random, blocked and Latin square orders, and balanced sides
    plan              the trials of one session
    check             what of a study can be shown, how long it takes, and what it can find
    power             the simulated power to find a stated effect

Procedures and analysis:

    procedures/       which level a trial shows
    analysis/         statistics of answers
    behaviour         rows of answers, from the folders of sessions
    published         results of publications
    published_tables  published results in the form of our own
    results           tables and pictures of an analysis, as plain numbers
    answer_sections   sections on correct and incorrect answers
    measure_sections  sections on psychometric functions, ratings, rankings and measures of the motion
    analyze           the complete analysis of sessions
    report            the report as a page

Running a session:

    session           begins or resumes a session
    session_folder    the folder of a session
    session_log       its log: each record is on disk before the session continues
    progress          how far a session is, from its log
    runner            runs the trials of a plan one after another
    event_codes       the numbers by which other programs follow a session
    lsl               samples and event codes as outlets of Lab Streaming Layer
    trial_scenes      the configurations of a trial, and what a participant sees
    stage             the interface of what renders a trial
    daemon_stage      on a daemon, in real time
    offline_stage     by hapticd.simulate, without a daemon
    front             the interface to participant and experimenter
    text_front        a person at a terminal
    pages/            a page for the participant, and one for the experimenter
    replies           a typed or set value as an answer
    participants/     simulated participants: how they move, what they feel, how they judge
    measures          overtravel, peak force, time and path from telemetry
    bids              tables of behaviour
"""
