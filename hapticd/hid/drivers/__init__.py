"""Drivers that set up devices: the PID class (pid*.py), and devices with vendor reports (vendor.py)."""
