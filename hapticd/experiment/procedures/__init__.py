"""Procedures that choose the level of each trial and estimate the threshold from the answers.

procedure         interface and base class of all procedures; answers, states and estimates
posterior         posteriors on a grid, for staircase and quest_plus
staircase         transformed and weighted up-down staircases
quest_plus        QUEST+: the level from which the most information is expected
constant_stimuli  each level equally often, in random order
"""
