"""Recordings of surfaces: files of three kinds, in SI units, on one clock, with what is wrong in them.

files       a recording's file: its bytes, and what reads them
table       a file as columns of numbers, before it is read: what every kind of file gives
csv_table   columns of a .csv
npz_table   columns of a .npz
wav_table   columns of a .wav
quantities  the quantities that a recording may hold, their units, and how large each can be
clock       columns on a uniform clock: what their times say, and what can be put right
clipping    clipped samples
spans       where a mask of samples is true
sensor      what a sensor's mounting and filter make of a decaying sinusoid
"""
