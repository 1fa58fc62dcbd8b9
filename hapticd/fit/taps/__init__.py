"""The taps of a recording: found, fitted one by one, and the law of all.

events       finds taps where it is loud, fits each with its speed, says why one cannot be used
ringing      decaying sinusoids in a stretch of acceleration, by variable projection
hit          one tap as it was found and fitted, and its noise
second_mode  a second mode that is struck together with the first
law          figures of taps over the approach speed: a line through the origin, or points
amplitude    the amplitude over the approach speed: a line, a power law, or a table
modes        frequency and decay time over the approach speed
pulse_shape  the shape that pulses have in common
lack_of_fit  whether what taps leave over has a shape
"""
