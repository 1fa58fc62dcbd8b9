"""Batches of fits: fits the recordings of a tree with one folder for each material.

folder_yaml     the keys of fit.yaml, the fit options of a folder
tree            reads a tree: its recordings by material and kind, and all its faults
batch           a batch as a study of the engine (`sweeps/work.py`): each point is a fit
ranking         the materials of a batch, ranked by verdict
output          the output files: a YAML file for each material, and CSV tables
page            the HTML page of a batch, with its plots
"""
