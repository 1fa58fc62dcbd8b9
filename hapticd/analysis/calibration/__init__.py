"""Calibration of handle and grip, and verification of what a device displays.

rig            the device under test: the simulated joystick without a clock, or a device with its servo
handle         `hapticd calibrate`: drives the handle free and held, fits both drives, reports and plots the result
sweep          a drive: a sequence of force bursts, each of one frequency
fit            fits mass, damping, dry friction and stiffness to a drive, with confidence intervals
verify         `hapticd verify`: strikes each mode of the library, also on walls, and compares the acceleration
accelerometer  reads an accelerometer's recording, aligns it with a drive, and compares it with the fit
"""
