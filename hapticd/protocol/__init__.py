"""The protocol between a daemon and its clients: encoding, messages, results, events, changes.

Encoding:

    zmtp                     ZMTP, the wire protocol of ZeroMQ: parser and writer
    messages                 JSON-RPC 2.0 in msgpack: requests, replies, error codes, frames
    streams                  notifications of streamed targets and forces
    calls                    a client's side of a call: request, reply, exceptions

Contents:

    results                  types of the results of methods, and of telemetry
    validation               validates objects and materials in a message; reports all faults with their paths
    displayability_warnings  warnings of objects and materials that are not displayed as written
    events                   events as maps with named members
    changes                  changes by commands, as the topic `change` publishes them
    marks                    texts and data of marks that the servo has not yet returned

Connection:

    places                   the runtime directory of a daemon, and why a daemon does not answer

Questions, and where to begin:

    What are the parameters and the result of a method?
        docs/protocol.md; parameters are in daemon/params, results in results.
    Where does an error get its code?
        messages (Code) has the codes; daemon/methods chooses one; calls (RemoteError) raises it in a client.
    Where are parameters validated?
        In daemon/methods (call) by the models of daemon/params; scenes and materials in validation.
"""
