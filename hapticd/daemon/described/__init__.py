"""The protocol as documents that programs read: OpenRPC of the requests, AsyncAPI of telemetry and streams.

Both are made of what the daemon itself validates and sends with:

    documents   the OpenRPC document (methods, params, results, errors) and the AsyncAPI document (topics, streams)
    schemas     JSON Schema of params, results and telemetry, in the dialect of both
    words       summaries, error codes, and what the daemon validates that JSON Schema cannot say
"""
