"""The protocol between a daemon and its clients: encoding, messages, results, events, changes.

Encoding:

    zmtp                     ZMTP, the wire protocol of ZeroMQ: parser and writer
    messages                 JSON-RPC 2.0 in msgpack: requests, replies, error codes, frames
    streams                  notifications of streamed targets and forces
    calls                    a client's side of a call: request, reply, exceptions

Contents:

    results                  types of the results of methods, and of telemetry
    validation               objects and materials in a message, validated with every fault at its place
    displayability_warnings  warnings of objects and materials that cannot be displayed as written
    events                   events as maps with named members
    changes                  changes by commands, as the topic `change` publishes them
    marks                    texts and data of marks that the servo has not yet returned

Connection:

    places                   the runtime directory of a daemon, and why a daemon does not answer

Questions, and where to begin:

    What does a method take and answer?
        docs/protocol.md; parameters are in daemon/params, results in results.
    Where does an error get its code?
        messages (Code) has the codes; daemon/methods chooses one; calls (RemoteError) raises it in a client.
    How does a method get its parameters checked?
        daemon/methods (call) by daemon/params; scenes and materials by validation.
"""
