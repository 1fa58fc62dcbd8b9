"""Batches of fits: a tree of folders, one a material, through the fits of hapticd.fit.

folder_yaml     the keys of fit.yaml, which says how the recordings of a folder are fitted
tree            the recordings of a tree, by material and kind, with every fault of the tree
batch           what the engine computes: one fit a point
ranking         the materials of a batch, ranked by verdict
output          the files of a batch: a YAML for each material, tables
page            the page of a batch, with its pictures
"""
