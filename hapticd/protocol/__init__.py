"""What passes between a daemon and its clients: messages, calls, events, changes, keys."""
