"""Calibration of handle and grip, and verification of what a device displays.

rig            the driven device: the simulated joystick without clock, or a device at its servo
handle         `hapticd calibrate`: drives the handle free and held, fits both drives, reports and plots the result
sweep          the drive: a sequence of bursts, each of one frequency
fit            mass, damping, dry friction and stiffness from a drive, with intervals
verify         `hapticd verify`: strikes each mode of the library, also on walls, and compares the acceleration
accelerometer  recordings of an accelerometer: read, aligned with the drive, compared
"""
