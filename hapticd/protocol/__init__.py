"""What passes between a daemon and its clients: messages, calls, events, changes, keys.

The wire:

    zmtp                     bytes of ZeroMQ's protocol to messages, and back
    messages                 JSON-RPC 2.0 in msgpack: requests, answers, error codes, the frames around them
    streams                  streamed targets and forces: one short notification each, written and read
    calls                    the client's side of a call: what it sends, what an answer says, which exception it is

What messages say:

    results                  the types of what methods answer and telemetry holds
    validation               objects and materials of a message, validated with every fault at its place
    displayability_warnings  what of a message cannot be displayed as it was meant
    events                   events as maps with named members
    changes                  what commands changed, as the topic `change` publishes it
    marks                    marks on their way through the servo

Where a daemon is:

    places                   whether a daemon is there, and why it does not answer

Questions, and where to begin:

    What does a method take and answer?
        docs/protocol.md; parameters are in daemon/params, results in results.
    Where does an error get its code?
        messages (Code) has the codes; daemon/methods decides which; calls (RemoteError) makes exceptions of them.
    How does a method get its parameters checked?
        daemon/methods (call) by daemon/params; scenes and materials by validation.
"""
