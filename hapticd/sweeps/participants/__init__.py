"""Simulated participants of an experiment, computed like the points of a sweep.

bulk              the participants as a study of the engine (`sweeps/work.py`)
one_session       runs the session of one participant and returns it as a row
session_folders   writes rows as session folders, which `hapticd experiment analyze` reads
"""
