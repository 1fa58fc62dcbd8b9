"""Many simulated participants of an experiment, each a point that is known by what it computes.

bulk              the participants of a study, as the engine takes them
one_session       the session of one of them, as a row
session_folders   rows as the folders that `hapticd experiment analyze` reads
"""
