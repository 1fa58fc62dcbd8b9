"""`hapticd bridge`: between TCP with CURVE and the daemon's own two sockets, in a process without the device.

The way of a connection:

    gate         takes connections; `Gate.authorize` decides whether a key is let in and what it may; ends them
    zap          libzmq's question whose key it is, once in each handshake; passes it to `Gate.authorize`
    accounts     the clients that the configuration names, and what each of them has taken
    limits       how often a line is logged
    relay        requests on their way to the daemon, one at a time for each connection
    daemon_link  the daemon's status, and its telemetry, passed on to `Gate.publish`

Around it:

    process      sockets, signals and the event loop; a reload of the configuration
    config       where the bridge listens, its key, its clients and their rights
    metrics      the daemon's status and the bridge's counters, in Prometheus' text format
    http         the endpoint that Prometheus asks

Questions, and where to begin:

    Who is let in, and what may they do?
        gate (Gate.authorize), by the rights in config (BridgeClient).
    How does a request reach the daemon, and its answer the client?
        gate (Connection) moves the bytes, libzmq decrypts them, relay (Relay) passes the request on.
    How does telemetry reach a client?
        daemon_link receives it while somebody listens; Gate.publish sends it to each connection.
    What happens when a key is revoked?
        process reads the configuration again, and Gate.drop ends the connections of that client.
"""
