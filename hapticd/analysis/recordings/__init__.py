"""Recordings of surfaces: files of three kinds, in SI units, on one clock, with what is wrong in them.

files     a recording's file: its bytes, and its columns as numbers, from .csv, .npz or .wav
clock     the quantities and their units; columns on a uniform clock, and what of their times can be put right
clipping  clipped samples
spans     where a mask of samples is true
sensor    what a sensor's mounting and filter make of a decaying sinusoid
"""
