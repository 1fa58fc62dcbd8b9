"""A session in the browser: the participant's page and the experimenter's page, each at a separate port.

The session runs in a thread, the servers of the pages in the event loop of the main thread.

    process             starts session and pages, and closes everything when the session ends
    pages_front         the front (user interface): content of the pages, and messages from them
    screens             content of the participant's page
    console             content of the experimenter's page
    presence            detects which pages are open and respond
    participant_page    methods of the participant's page, and the stylus that it draws, never below a surface
    experimenter_page   methods of the experimenter's page

`static/` holds the files of both pages, which also use hapticd/web/static.
"""
