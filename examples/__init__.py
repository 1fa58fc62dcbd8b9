"""Examples: clients, notebooks, PsychoPy during a session, and the demo of `make demo`."""
