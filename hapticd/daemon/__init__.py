"""The daemon's process: its sockets and threads, the protocol's methods, telemetry, the flight recorder.

From a request to the servo, and back:

    process          configuration, runtime directory, threads, signals: starts everything and takes it down
    peers            a listening socket and the ZeroMQ peers that come to it, each in its turn (ADR 0024)
    router           the command socket: frames in, answers out
    dispatch         the command thread: answers requests, makes changes in steps and answers others between them, beats
    methods          the protocol's methods: what each does and answers, and the code of each error
    params           what the methods take
    described/       the protocol as OpenRPC and AsyncAPI documents, made of params, results and records
    refusal          why a request is refused
    streams          streamed targets and forces: who sends, in which order, and what became of every message
    lease            forces stay on only while somebody renews the lease
    reload           reads the configuration again, and says what needs a restart
    engine           scene, compiled table and servo: what the methods act on
    command_ring     sends commands to the servo, and waits for the tick that takes them

What the servo reports:

    telemetry        the telemetry thread: drains the servo's rings and makes messages of them
    publisher        the telemetry socket: sends those messages to subscribers
    counters         what the servo counts, read from the structs of csrc/api/
    status           the result of `get_status`
    status_text      the status as a person reads it; clients use it, too
    flight_recorder  the last seconds, kept, and written by the flight thread on a fault or on request
    flight_scene     what those seconds were rendered with

Questions, and where to begin:

    What happens when a method is called?
        dispatch (take) decodes it, methods (perform, change) checks its parameters and carries it out on the engine.
    How does a scene reach the servo?
        methods (_set_scene), then engine, which has rendering/compiler/table rewrite what changed and publishes it.
    Why did a request get an error?
        refusal (MethodError) is the error of the answer; methods (_refusals) makes it of what others raise. Faults of
        keys and values are put into words by base/model (_fault).
    Where does a sample go?
        telemetry drains it; publisher sends it; flight_recorder keeps it.
    What ends the force?
        csrc/servo/hd_servo_watch.c, or the tick itself; Python only reports it.
"""
