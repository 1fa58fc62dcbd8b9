"""Machine-readable descriptions of the protocol: OpenRPC of the requests, AsyncAPI of telemetry and streams.

Both are generated from the models and records that the daemon validates and sends with:

    documents   the OpenRPC document (methods, params, results, errors) and the AsyncAPI document (topics, streams)
    schemas     JSON Schema of params, results and telemetry, in the draft that both documents use
    words       summaries, error codes, and validation rules that JSON Schema cannot express
"""
