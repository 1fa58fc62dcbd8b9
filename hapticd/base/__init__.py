"""What everything else stands on, and what knows nothing of haptics: errors, YAML, clocks, files, the C core."""
