"""Batches of fits: fits the recordings of a tree that has a folder for each material.

folder_yaml     the keys of fit.yaml, the fit options of a folder
tree            reads a tree: its recordings by material and kind, and all its faults
batch           a batch as work of the engine: each point is a fit
ranking         the materials of a batch, ranked by verdict
output          the output files: a YAML file for each material, and CSV tables
page            the HTML page of a batch, with its plots
"""
