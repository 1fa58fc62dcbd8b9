"""How each class of device is set up and driven: the PID class (pid*.py), and devices with reports of their own."""
