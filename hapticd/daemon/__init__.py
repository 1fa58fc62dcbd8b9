"""The daemon's process: its sockets and threads, the protocol's methods, telemetry, the flight recorder.

From a request to the servo, and back:

    process          configuration, runtime directory, threads, signals: starts and stops everything
    peers            a listening socket and its ZeroMQ peers, served in turn (ADR 0024)
    router           the command socket: receives requests, sends answers
    dispatch         the command thread: answers requests, runs changes in steps, sends the servo a heartbeat
    methods          the handlers of the protocol's methods, and the code of each error
    params           the params of the methods
    described/       the protocol as OpenRPC and AsyncAPI documents, generated from params, results and records
    refusal          the exception that carries the error object of an answer
    streams          streamed targets and forces: sender, order and counters of messages
    lease            the lease: forces stay on only while a client renews it
    reload           reads the configuration again, and finds changed keys that need a restart
    engine           scene, compiled table and servo, on which the methods act
    command_ring     sends commands to the servo, and waits for the tick that takes them

Telemetry and status:

    telemetry        the telemetry thread: drains the servo's rings into messages
    publisher        the telemetry socket: sends those messages to subscribers
    counters         the servo's counters, read from the structs of csrc/api/
    status           the result of `get_status`
    status_text      the status as lines of text, for `hapticd status`
    flight_recorder  keeps the last seconds of telemetry; the flight thread writes them on a fault or on request
    flight_scene     the scene at the beginning of those seconds, and its changes since

Questions, and where to begin:

    What happens when a method is called?
        dispatch (take) decodes the request; methods (perform, change) validates its params and carries it out on the
        engine.
    How does a scene reach the servo?
        methods (_set_scene), then engine: rendering/compiler/table compiles the changed objects, engine publishes the
        table.
    Why did a request get an error?
        refusal (MethodError) is the error of the answer; methods (_refusals) converts other exceptions to it.
        base/model (_fault) phrases the problems of keys and values.
    Where does a sample go?
        telemetry drains it; publisher sends it; flight_recorder keeps it.
    What turns the force off at a fault?
        csrc/servo/hd_servo_watch.c, or the tick itself; Python only reports the fault.
"""
