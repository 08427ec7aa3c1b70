"""Who may do what: a token to see images, another to control; none on loopback unless they are configured."""

import secrets
from typing import Literal

from pydantic import SecretStr
from starlette.datastructures import Headers, QueryParams

from tactiled.config import Server

Scope = Literal["read", "control"]
COOKIE = "tactiled"


class Keys:
    """Checks what a request shows: `Authorization: Bearer`, the viewer's cookie, or `?token=`."""

    def __init__(self, server: Server) -> None:
        given: dict[Scope, SecretStr | None] = {"read": server.read_token, "control": server.control_token}
        self._tokens = {scope: token.get_secret_value().encode() for scope, token in given.items() if token}

    @property
    def needed(self) -> bool:
        """Whether anything must be shown at all."""
        return bool(self._tokens)

    def scopes(self, shown: str) -> frozenset[Scope]:
        """What a token allows; compared in a time that tells nothing of it."""
        given = shown.encode()
        good = {scope for scope, token in self._tokens.items() if secrets.compare_digest(given, token)}
        return frozenset({"read", "control"} if "control" in good else good)

    def allowed(self, headers: Headers, query: QueryParams) -> frozenset[Scope]:
        """What a request may do."""
        if not self.needed:
            return frozenset({"read", "control"})
        return self.scopes(shown(headers, query))


def shown(headers: Headers, query: QueryParams) -> str:
    """The token that a request shows, or nothing."""
    kind, _, token = headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return token.strip()
    if "token" in query:
        return query["token"]
    for part in headers.get("cookie", "").split(";"):
        name, _, value = part.strip().partition("=")
        if name == COOKIE:
            return value
    return ""
