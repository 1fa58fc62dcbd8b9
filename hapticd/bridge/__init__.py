"""`hapticd bridge`: between TCP with CURVE and the daemon's own two sockets, in a process without the device.

A connection comes in by `gate`, which moves its bytes, `limits` says how fast, `zap` says whose it is; its requests
go on by `relay`, telemetry comes by `feed`, both by `daemon_link`. `metrics` and `http` tell Prometheus.
"""
