"""Experiments with people: studies, sessions and their analysis.

What is asked:

    keys              the keys of a study's YAML file, each with its range
    plain_values      values of YAML that a model takes as they are
    key_paths         changes of a configuration by the paths of its keys
    study             reads a study, with every fault at its line
    faults            what is wrong between the keys of a study
    display_faults    what the configuration refuses of a study's stimuli
    stimuli           a stimulus as a scene: the base configuration and what is changed in it
    cells             which sets of stimuli a study presents, how often, and what answer is correct
    order             random, blocked and Latin square orders, and balanced sides
    plan              the trials of one session
    check             what of a study can be shown, how long it takes, and what it can find
    power             the simulated power to find a stated effect

Procedures and analysis:

    procedures/       which level a trial shows
    analysis/         statistics of answers
    behaviour         rows of answers as sessions' folders have them
    published         results as publications have them
    published_tables  published results in the form of our own
    results           tables and pictures of an analysis, as plain numbers
    answer_sections   what is reported of right and wrong answers
    measure_sections  what is reported of psychometric functions, ratings, rankings and measures of the motion
    analyze           all that is reported of sessions
    report            the report as a page

Running a session:

    session           begins a session, or goes on with one
    session_folder    the folder of a session
    session_log       its log: every record on disk before anything goes on
    progress          how far a session is, from its log
    runner            trial after trial of a plan
    event_codes       the numbers by which other programs follow a session
    lsl               samples and event codes as outlets of Lab Streaming Layer
    trial_scenes      the configurations of a trial, and what a participant sees
    stage             where trials are felt
    daemon_stage      on a daemon, in real time
    offline_stage     by hapticd.simulate, without a daemon
    front             who answers and who watches
    text_front        a person at a terminal
    pages/            a page for the participant, and one for the experimenter
    replies           what a participant typed or set, as an answer
    participants/     simulated participants: how they move, what they feel, how they judge
    measures          overtravel, peak force, time and path from telemetry
    bids              tables of behaviour
"""
