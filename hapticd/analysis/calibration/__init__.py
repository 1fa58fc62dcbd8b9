"""Calibrating handle and grip, and verifying what a device displays: rigs, the sweep, the fit, the plot.

rig            what is driven: the simulated joystick without clock, or a device at its servo
handle         `hapticd calibrate`: drives free and held, fits both, says what handle and hand are, and draws it
sweep          the drive: bursts of one frequency after the other
fit            mass, damping, dry friction and stiffness from a drive, with bounds
verify         `hapticd verify`: strikes each mode of the library, also on walls, and compares the acceleration
accelerometer  recordings of an accelerometer: read, aligned with what was driven, compared
"""
