"""What the operating system is asked for: paths, the log, systemd, idle states, installed files."""
