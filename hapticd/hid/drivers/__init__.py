"""How a HID device is told forces: the PID class, and devices with reports of their own."""
