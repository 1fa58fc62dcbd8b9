"""Clients of a daemon: blocking and asyncio, samples, recordings, the live view.

    methods         the client: methods of the daemon and subscriptions, as coroutines without an event loop
    asynchronous    `hapticd.aio.connect`: the coroutines on an event loop
    blocking        `hapticd.connect`: the coroutines as blocking calls on the caller's thread
    sources         scenes, patches and operators given as mappings, models or files
    streams         the connection for streamed targets and forces
    samples         batches of samples as numpy arrays, and counts of lost samples
    record          recordings of a running daemon, for a duration or while a block of code runs
    flight_summary  the contents of a flight file
    watch           the live view of `hapticd watch`
    base            connecting a socket, time-outs, warnings at the line of the caller

Questions, and where to begin:

    How does a method of the protocol become one of a client?
        As a coroutine in methods; blocking wraps it (_method).
    Where is a reply decoded, and an error raised?
        protocol/calls (decode_response, result_of).
    How are lost samples noticed?
        samples (SampleStream).
"""
