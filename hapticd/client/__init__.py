"""Clients of a daemon: blocking and asyncio, samples, recordings, the live view.

    methods         the daemon's methods, once for both clients: arguments, what they send, documentation
    base            what both clients share, without I/O
    blocking        `hapticd.connect`: methods as ordinary calls
    asynchronous    `hapticd.aio.connect`: methods as coroutines
    streams         the connection over which a client streams targets and forces
    feed            telemetry without I/O: what a subscription subscribes to, and what it makes of each message
    samples         batches of samples as numpy arrays, and what was lost on the way
    record          records a running daemon into a file
    background      a recording by a thread, while a block of code runs
    flight_summary  what a file of the flight recorder holds
    watch           the live view of `hapticd watch`

Questions, and where to begin:

    How does a method of the protocol become one of a client?
        methods describes it; blocking and asynchronous make the call (_method).
    Where is an answer decoded, and an error raised?
        protocol/calls (decode_response).
    How are lost samples noticed?
        samples (SampleStream).
"""
