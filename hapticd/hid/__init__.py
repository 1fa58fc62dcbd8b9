"""HID devices: what their report descriptors say, how they are set up, and how they are found."""
