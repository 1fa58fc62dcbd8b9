"""A page in the browser: `hapticd web`. A process of its own, which is a client of a daemon like any other.

One thread, one event loop, in this order:

    process         the life of the process: from the options to the printed address and the end
    demo            a daemon of our own, with the simulated joystick and a scene that shows everything
    opening         opens addresses in the browser of this machine
    listening       where it listens: this machine alone, or with TLS and a password others, too
    http_server     aiohttp's server at that port
    connections     the connections of browsers: how many, and how long each may take
    tasks           the end of a task of the event loop
    application     the HTTP routes: the static page, the WebSocket
    security        who is let in: the one-time token, the password, the cookie; headers of every answer
    hosts           under which names it is asked: Host and Origin of every request
    sessions        tokens that are good once, and the sessions of browsers
    passwords       the password file, and how often a password may be tried
    door            what somebody sees who has not been let in
    telemetry_hub   the daemon's telemetry, passed on to every page as it came
    metrics         figures for Prometheus, from the daemon's status
    page            one page: its WebSocket, what it may ask and what it is answered
    outbox          what waits to be sent to a page
    page_limits     how much a page may ask
    token_bucket    how much somebody may ask: so much at once, and so much a second
    page_calls      what a page may call of the daemon
    page_lease      forces only under a lease of the page
    daemon_relay    a page's own connection to the daemon
    page_methods    methods of this process that every page needs

What a page may ask for besides:

    yaml_methods    methods of a page: what may be edited, and the files that hold it
    editor_schema   what may be edited: the JSON Schema of materials, objects and scene, with units
    shipped_materials   the shipped materials, as they are before anybody changes them
    yaml_files      what a file holds for the daemon; the page's scene and materials as a file
    yaml_editing    a YAML text changed in place, with its comments
    recording_methods   methods and routes of recordings: record, list, download, delete, open and look through
    recorder        a recording that a page begins and any page ends
    recording_folder    names, a list, files to read and to delete
    uploads         recordings that a person sends to look at
    playback        a recording that is open: its samples by row, the scene at a row

`static/` is the page itself. `static/main.js` says how its modules fit together.

Questions, and where to begin:

    What goes over the WebSocket?
        page, which has it all at its top.
    How does a page call something new of this process?
        application (METHODS): each group of methods is a file with a table.
    Why does a slow page slow nobody?
        outbox (Outbox); page (Page), which closes one that reads nothing; page_limits.
    Why can no other site command the joystick?
        hosts, then security (Guard).
    What ends the force when a tab is closed?
        page_lease.
"""
