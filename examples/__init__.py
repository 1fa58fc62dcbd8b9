"""Examples: what `make demo` shows, and PsychoPy beside a session."""
