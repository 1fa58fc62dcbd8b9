"""What somebody sees who has not been let in: how to get an address, or the form for the password.

Plain HTML without a script; its style is static/door.css, which is for everybody.
"""

from __future__ import annotations

import os
from html import escape

_PAGE = """<!doctype html>
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


def no_address(used: bool) -> str:
    """For who comes without a token, or with one that was used."""
    why = "This address has been used: it lets in one browser, once." if used else "This browser has not been let in."
    body = f"""<p>{why}</p>
<p>To get a new address, do one of these:</p>
<ul>
<li>In a terminal of the user that runs the server of this page: <code>kill -USR1 {os.getpid()}</code>. It prints new
addresses, for a service into the journal.</li>
<li>If a browser has the page of <code>hapticd web</code> open: ask that page for an address for another browser.</li>
</ul>"""
    return _PAGE.format(title="hapticd: a new address is needed", head="", body=body)


def login(problem: str = "") -> str:
    """The form."""
    told = f'<p class="problem" role="alert">{escape(problem)}</p>' if problem else ""
    body = f"""{told}<form method="post" action="/login">
<label for="password">Password</label>
<input id="password" name="password" type="password" autocomplete="current-password" required autofocus>
<button type="submit">Log in</button>
</form>"""
    return _PAGE.format(title="hapticd: log in", head="", body=body)


def onward() -> str:
    """For who was led here by another site: the browser sends our cookie only to who comes from a page of ours."""
    body = '<p><a href="/">Open the page</a></p>'
    return _PAGE.format(title="hapticd", head='\n<meta http-equiv="refresh" content="0; url=/">', body=body)


def leads_to(address: str) -> str:
    """A file that a browser opens instead of the address."""
    body = f'<p><a href="{escape(address)}">Open the page</a></p>'
    head = f'\n<meta http-equiv="refresh" content="0; url={escape(address)}">'
    return _PAGE.format(title="hapticd", head=head, body=body).replace('<link rel="stylesheet" href="/door.css">', "")
