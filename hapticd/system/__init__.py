"""What the operating system is asked for: paths, the log, systemd, idle states, installed files.

    paths           where a daemon and its clients meet: the runtime directory, its names, its lock and its sockets
    journal         where the log goes, and which events of the servo it has
    repeated_lines  lines of the log that repeat each other, summed up
    notify          systemd's notifications: ready, alive, reloading, stopping, and a line of state
    service_files   `hapticd install-service`: the units of this installation, put in place by systemd/install.sh
    trusted_files   files that are obeyed: refused where somebody else may change them
    open_files      how many descriptors the process may have, and how many clients may take
    idle_states     keeps the processors out of deep idle states

Questions, and where to begin:

    Which runtime directory is used?
        paths (runtime_paths).
    Why is a daemon refused as the second one?
        paths (owned).
    Why is a line of the log missing, or a sum?
        repeated_lines (Repeats); which events are lines at all: journal (EventLog).
"""
