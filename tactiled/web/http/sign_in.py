"""The page that asks the person at a browser for a token, where a program gets an error that it can read."""

from base64 import b64encode
from hashlib import sha256
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Receive, Scope

PATHS = ("/", "/docs")  # the pages
STYLE = (
    ":root{color-scheme:light dark}body{font:16px/1.5 system-ui,sans-serif;margin:15vh auto 0;max-width:22rem;"
    "padding:0 1rem}label{display:block;font-weight:600}input,button{font:inherit;padding:.5rem;"
    "box-sizing:border-box;width:100%;margin-top:.5rem}"
)
PAGE = """<!doctype html>
<html lang="en">
<head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>tactiled: token</title><style>{style}</style></head>
<body><main><h1>tactiled</h1><p id="why">{why}</p>
<form method="post"><input name="username" autocomplete="username" value="tactiled" hidden>
<label for="token">Token</label>
<input id="token" name="token" type="password" autocomplete="current-password" required autofocus
 aria-describedby="why">
<button>Open</button></form></main></body>
</html>
"""
WANTED = "This service needs a token: the <code>read_token</code> or the <code>control_token</code> of its file."
UNKNOWN = "This token is unknown. " + WANTED
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        f"default-src 'none'; style-src 'sha256-{b64encode(sha256(STYLE.encode()).digest()).decode()}'; "
        "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "same-origin",  # without one a form's Origin is null
    "WWW-Authenticate": "Bearer",
}


def is_wanted(scope: Scope) -> bool:
    """Whether a browser asks for one of the pages."""
    return (
        scope["method"] == "GET"
        and scope["path"] in PATHS
        and "text/html" in Headers(scope=scope).get("accept", "")
    )


def is_sent(scope: Scope) -> bool:
    """Whether a request is the form, filled in."""
    kind = Headers(scope=scope).get("content-type", "").partition(";")[0]
    return scope["method"] == "POST" and scope["path"] in PATHS and kind == "application/x-www-form-urlencoded"


def page(unknown: bool = False) -> Response:
    """The form, which leads back to the address it stands at; `unknown`: what was given is no token."""
    text = PAGE.format(style=STYLE, why=UNKNOWN if unknown else WANTED)
    return Response(text, 401, HEADERS, "text/html")


async def token(receive: Receive) -> str:
    """The token in the form, or ""; the body is in."""
    body: bytes = (await receive()).get("body", b"")
    return parse_qs(body.decode(errors="replace")).get("token", [""])[0].strip()
