"""A page in the browser: `hapticd web`, a separate process that is a client of a daemon.

One thread with one event loop, in the order from the process to the daemon:

    process         the process: from the options to the printed address and the end
    demo            a separate daemon with the simulated joystick and the scene of shipped/play.yaml
    opening         opens addresses in the browser of this machine
    listening       the listening socket: for this machine only or, with TLS and a password, for others too
    http_server     aiohttp's server on that socket
    connections     the connections of browsers: their number and their time limits
    tasks           cancels a task of the event loop
    application     the HTTP routes: the static page, the WebSocket
    security        access control: the one-time token, the password, the cookie; headers of every response
    hosts           checks Host and Origin of every request
    sessions        one-time tokens, and the browsers' sessions
    passwords       the password file, and the rate limit of logins
    door            the pages for a browser without access: a hint or the password form
    telemetry_hub   receives the daemon's telemetry and passes it on to every page unchanged
    metrics         metrics for Prometheus, from the daemon's status
    page            one page: its WebSocket, its calls and their answers
    outbox          the queue of messages to a page
    page_limits     limits of a page's calls and messages
    token_bucket    a rate limiter
    page_calls      the methods of the daemon that a page may call
    page_lease      lets a page turn forces on only while it holds a lease
    daemon_relay    the connection of one page to the daemon
    page_methods    methods of this process for every page: state, subscriptions, shipped materials

Further methods that a page may call:

    yaml_methods    methods of a page: the editors' schema, and files of scenes and materials
    editor_schema   the JSON Schema of materials, objects and scene, with units, for the editors
    yaml_files      checks the text of a file; writes the scene and materials of the page as a file
    yaml_editing    changes a YAML text in place and keeps its comments
    recording_methods   methods and routes of recordings: record, list, download, delete, open and show
    recorder        a recording that any page can begin and end
    recording_folder    the folder of recordings: names, list, files to read and to delete
    uploads         recordings that a browser uploads to show them
    playback        an open recording: its samples by row, the scene at a row

`static/` is the page. `static/main.js` explains how its modules work together.

Questions, and where to begin:

    What is sent over the WebSocket?
        page, in its docstring.
    How does a page call a new method of this process?
        application (WEB_PAGE_METHODS): each group of methods is a file with a table.
    Why does a slow page not delay others?
        outbox (Outbox); page (Page), which closes a page that reads nothing; page_limits.
    Why can no other site command the joystick?
        hosts, then security (Guard).
    What ends the force when a tab is closed?
        page_lease.
"""
