"""The main job, shown: `make demo`.

Starts the daemon on the simulated joystick in a process of its own and drives it over ZeroMQ: taps on the seven
materials of the paper, strokes over a comb and over sandpaper, and a puncture. Telemetry alone says what was rendered:
it is measured here by other means than it was made, and compared with the library. Ends by itself.
"""
