"""What is refused before there is a request."""

import json
import logging

import pytest

from tests.web.http.test_attacks import plug, said

KEY = "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg=="
UPGRADE = "Connection: Upgrade\r\nUpgrade: websocket"
STREAM = "GET /api/v1/stream HTTP/1.1"


@pytest.mark.parametrize(
    ("request_", "status", "says"),
    [
        ("FOO BAR / HTTP/1.1\r\nHost: {host}\r\n\r\n", 400, "no HTTP request: "),
        ("\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", 400, "no HTTP request: "),
        ("PUT / HTTP/1.1\r\nHost: {host}\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nx", 400, "no HTTP"),
        ("POST /nope HTTP/1.1\r\nHost: {host}\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n", 400, "no HTTP"),
        (f"{STREAM}\r\nHost: {{host}}\r\n{UPGRADE}\r\n\r\n", 400, "missing Sec-WebSocket-Key header"),
        (
            f"{STREAM}\r\nHost: {{host}}\r\n{UPGRADE}\r\n{KEY}\r\nSec-WebSocket-Version: 7\r\n\r\n",
            400,
            "Sec-WebSocket-Version",
        ),
    ],
)
def test_what_is_no_request_is_a_problem_with_the_headers_of_all(url, request_, status, says, caplog):
    with plug(url) as end, caplog.at_level(logging.ERROR):
        end.sendall(request_.format(host=url[7:]).encode("latin-1"))
        head, _, body = said(end).partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = dict(line.lower().split(": ", 1) for line in lines)
    assert first == f"HTTP/1.1 {status} Bad Request"
    assert headers["content-type"] == "application/problem+json"
    assert (headers["x-content-type-options"], headers["connection"]) == ("nosniff", "close")
    assert "default-src 'none'" in headers["content-security-policy"]
    assert int(headers["content-length"]) == len(body)
    told = json.loads(body)
    assert (told["status"], told["title"]) == (status, "Bad Request")
    assert says in told["detail"]
    assert "\n" not in told["detail"]
