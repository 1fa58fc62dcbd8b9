"""Many simulated participants of an experiment, each a point with an identity.

bulk              the participants as work of the engine
one_session       runs the session of one participant and returns it as a row
session_folders   writes rows as session folders, which `hapticd experiment analyze` reads
"""
