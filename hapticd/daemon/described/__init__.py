"""The protocol as documents that programs read: OpenRPC of the requests, AsyncAPI of telemetry and streams.

Both are made of what the daemon itself validates and sends with:

    openrpc             the OpenRPC document: every method, its params, results and errors
    asyncapi            the AsyncAPI document: every topic, and the messages of streams
    methods_in_words    what each method does, which type it answers with, and with which errors
    error_codes         when each error code is sent, and what its data holds
    params_schemas      JSON Schema of params: the models that validate them, scenes, materials and merge patches
    message_schemas     JSON Schema of results and telemetry: the types of protocol/results, records of the core
    draft7              the dialect of JSON Schema that OpenRPC and AsyncAPI have
    beyond_schema       what the daemon validates that JSON Schema cannot say
"""
