"""Clients of a daemon: blocking and asyncio, samples, recordings, the live view.

    methods         the client: the daemon's methods and subscriptions as coroutines, without an event loop
    asynchronous    `hapticd.aio.connect`: them on an event loop
    blocking        `hapticd.connect`: them on the caller's thread, as ordinary calls
    sources         scenes, patches and operators that are given as files or models
    streams         the connection over which a client streams targets and forces
    samples         batches of samples as numpy arrays, and what was lost on the way
    record          records a running daemon into a file, also while a block of code runs
    flight_summary  what a file of the flight recorder holds
    watch           the live view of `hapticd watch`
    base            how a socket is connected, which line a warning is about

Questions, and where to begin:

    How does a method of the protocol become one of a client?
        A coroutine of methods; blocking lists it once more (_method).
    Where is an answer decoded, and an error raised?
        protocol/calls (decode_response, result_of).
    How are lost samples noticed?
        samples (SampleStream).
"""
