"""Recordings of surfaces: files of three kinds, in SI units, on one clock, with what is wrong in them."""
