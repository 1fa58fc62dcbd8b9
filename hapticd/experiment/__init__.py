"""Psychophysical experiments: studies, sessions and their analysis.

Design of a study:

    keys              the keys of a study's YAML file, each with its range
    plain_values      pydantic types of values in YAML
    key_paths         the base of a study or sweep, and changes of it by the paths of its keys
    study             loads a study, and reports every fault with its line
    faults            conflicts between the keys of a study
    display_faults    invalid configurations of stimuli, at the keys that cause them
    stimuli           the configuration of a stimulus
    cells             which sets of stimuli a study presents, how often, and which answer is correct
    order             random, blocked and Latin square orders of trials, and of the stimuli in a trial
    plan              the trials of one session
    check             what the device cannot display, the duration of a session, and the power
    power             the statistical power of a study, by simulation

Procedures and analysis:

    procedures/       choose the level of each trial
    analysis/         statistics of answers
    behaviour         answers, read from the tables of sessions
    published         results of publications
    published_tables  published results in the form of an analysis
    results           tables, pictures and notes of an analysis, as plain numbers
    answer_sections   sections of an analysis on which answers were given and correct
    measure_sections  sections on psychometric functions, ratings, rankings and measures of motion
    analyze           the complete analysis of sessions
    report            the report of an analysis as an HTML page

Running a session:

    session           makes the folder of a session, and reads its plan again to resume it
    session_folder    the folder of a session
    session_log       the log of a session: each record is on disk before the session continues
    progress          the progress of a session, from its log
    runner            runs the trials of a plan
    event_codes       numbers that report the events of a session to other programs
    lsl               samples and event codes as outlets of Lab Streaming Layer
    trial_scenes      the configurations of a trial, and the surfaces that a participant sees
    stage             the interface of a stage, which renders trials
    daemon_stage      a stage on a daemon, in real time
    offline_stage     a stage that simulates servo and joystick, without a daemon
    front             the interface of a front, the user interface of participant and experimenter
    text_front        a front at a terminal
    pages/            a front in the browser, with a participant's page and an experimenter's page
    replies           converts typed texts and slider values to answers
    participants/     simulated participants: how they move, what they feel, how they judge
    measures          measures of the motion from telemetry: overtravel, peak force, time and path
    bids              tables of answers and events as BIDS prescribes
"""
