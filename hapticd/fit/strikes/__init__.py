"""Strikes of grooves: found, fitted stroke by stroke, and numbered along the surface.

stroke        one recording of a stroke: its strikes, their mode and their amplitudes
onsets        where strikes are
spacing       the regular row that strikes lie in, and the number of each strike's groove
free_ringing  free ringing between strikes, fitted in all stretches at once
"""
