"""What is refused before there is a request: in the form, and with the headers, of every other error."""

import sys
from http import HTTPStatus
from typing import Any

from starlette.responses import Response
from websockets.datastructures import Headers
from websockets.http11 import Response as Handshake

from tactiled.web import guard, problems
from tactiled.web.flow import PacedWebSocket
from tactiled.web.patience import PatientHttp


class TellingHttp(PatientHttp):
    """Says in a problem what uvicorn says in plain text of bytes that are no HTTP."""

    def send_400_response(self, msg: str) -> None:
        """Answer, while what the parser raised is handled, and close."""
        answer = _problem(400, f"no HTTP request: {sys.exception() or msg}")
        lines = (name + b": " + value for name, value in (*self.server_state.default_headers, *answer.raw_headers))
        self.transport.write(b"\r\n".join((b"HTTP/1.1 400 Bad Request", *lines, b"", bytes(answer.body))))
        self.transport.close()


class TellingWebSocket(PacedWebSocket):
    """Says in a problem what the library says in plain text of an upgrade to no WebSocket."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.conn.reject = _reject  # type: ignore[method-assign]


def _reject(status: int, text: str) -> Handshake:
    """The handshake's answer to a client that is refused."""
    answer = _problem(status, text.partition("\n")[0])
    return Handshake(int(status), HTTPStatus(status).phrase, Headers(answer.headers.items()), bytes(answer.body))


def _problem(status: int, detail: str) -> Response:
    return problems.response(status, detail, guard.HEADERS | {"Connection": "close"})
