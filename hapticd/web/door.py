"""The pages for a browser without access: how to get an address, or the password form.

The pages are plain HTML without a script. Their style, static/door.css, is also served without access.
"""

from __future__ import annotations

import os
from html import escape

_PAGE_TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<link rel="stylesheet" href="/door.css">{head}
</head>
<body>
<main>
<h1>{title}</h1>
{body}
</main>
</body>
</html>
"""


def address_needed_page(used: bool) -> str:
    """Return the page that explains how to get an address, for a browser without a token or with a used token."""
    why = "This address was used before: it works once." if used else "This browser has no access."
    body = f"""<p>{why}</p>
<p>To get a new address, do one of these:</p>
<ul>
<li>In a terminal of the user that runs the server of this page: <code>kill -USR1 {os.getpid()}</code>. It prints new
addresses, for a service into the journal.</li>
<li>If a browser has the page of <code>hapticd web</code> open: ask that page for an address for another browser.</li>
</ul>"""
    return _PAGE_TEMPLATE.format(title="hapticd: a new address is needed", head="", body=body)


def login_page(problem: str = "") -> str:
    """Return the page with the password form; `problem` says why the last password was refused."""
    alert = f'<p class="problem" role="alert">{escape(problem)}</p>' if problem else ""
    body = f"""{alert}<form method="post" action="/login">
<label for="password">Password</label>
<input id="password" name="password" type="password" autocomplete="current-password" required autofocus>
<button type="submit">Log in</button>
</form>"""
    return _PAGE_TEMPLATE.format(title="hapticd: log in", head="", body=body)


def continue_page() -> str:
    """Return a page that leads to /, for a browser that followed a link on another site.

    The browser sends the cookie only for requests that come from a page of this server.
    """
    body = '<p><a href="/">Open the page</a></p>'
    return _PAGE_TEMPLATE.format(title="hapticd", head='\n<meta http-equiv="refresh" content="0; url=/">', body=body)


def redirect_page(address: str) -> str:
    """Return a page that redirects to `address`, for a local file that a browser opens."""
    body = f'<p><a href="{escape(address)}">Open the page</a></p>'
    head = f'\n<meta http-equiv="refresh" content="0; url={escape(address)}">'
    return _PAGE_TEMPLATE.format(title="hapticd", head=head, body=body).replace(
        '<link rel="stylesheet" href="/door.css">', ""
    )
