"""Examples: what `make demo` shows."""
