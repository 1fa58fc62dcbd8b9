"""The demo of `make demo`: renders every kind of surface, measures it, and compares it with the material library.

The demo starts a daemon on the simulated joystick in a separate process and commands it over ZeroMQ: taps on the seven
materials of the paper, strokes over a comb and over sandpaper, and a puncture. It measures the rendered surfaces from
telemetry, with other code than the one that rendered them, and ends automatically.
"""
