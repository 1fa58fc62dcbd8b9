"""Adaptive procedures: which level a trial shows, and what threshold the answers give.

procedure         what every procedure is; answers, states and estimates
posterior         posteriors on a grid, for the next two
staircase         transformed and weighted up-down staircases
quest_plus        the level that is expected to tell most
constant_stimuli  each level equally often, in random order
"""
