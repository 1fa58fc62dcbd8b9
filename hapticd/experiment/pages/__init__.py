"""A session in the browser: the participant's page and the experimenter's, each at a port of its own.

The session runs in a thread, as at a terminal; the pages in the event loop of the main thread.

    process             starts both, waits for the session's end, and lets go of everything
    pages_front         between them: what the pages show, what they say; the front of the session
    screens             what the participant's page shows, made of what a participant may know
    console             what the experimenter's page shows
    presence            whether somebody looks at a page
    participant_page    what the participant's page may call, and the stylus that it draws
    stylus              where the stylus is drawn: never below a surface
    experimenter_page   what the experimenter's page may call

`static/` is what the browsers get, besides modules of hapticd/web/static.
"""
