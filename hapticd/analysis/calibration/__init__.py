"""Calibrating handle and grip, and verifying what a device displays: rigs, the sweep, the fit, the plot."""
