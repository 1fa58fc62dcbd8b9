"""Services of the operating system: paths, log, systemd notifications, idle states, installed files.

    paths           the runtime directory of a daemon: its sockets, its lock, its owner
    journal         the log on stderr, and the events of the servo that it contains
    repeated_lines  rate limit for repeated lines of the log
    notify          notifications to systemd: ready, watchdog, reloading, stopping, status line
    extras          the command that adds an extra to this installation
    service_files   `hapticd install-service`: adapts the units to this installation and runs systemd/install.sh
    trusted_files   reads files with keys or commands, and refuses them if other users may change them
    open_files      the limit of file descriptors, and how many connections it allows
    idle_states     keeps the processors out of deep idle states

Questions, and where to begin:

    Which runtime directory is used?
        paths (runtime_paths).
    Why is a daemon refused as the second one?
        paths (owned).
    Why is a line of the log missing, or replaced by a sum?
        repeated_lines (Repeats); for the events that are logged, journal (EventLog).
"""
