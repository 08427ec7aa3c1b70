"""The right to change something at a reader: a signature with its robot's key over the request; no secret leaves.

The reader's challenge holds for one request and a short time by its own clock. So neither a copy of a request nor
one for another robot changes anything, whatever the clocks show.
"""

import hmac
import json
import secrets
import threading
from hashlib import sha256
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from tactiled.bounds import Syntax

CHALLENGE_S = 10.0  # that a challenge holds
NO_KEY = "this reader has no zenoh.control_key: nothing may be changed from here"
NO_CLAIM = "this change carries no claim: a `tactiled serve` of this release that has zenoh.control_key sends one"
WRONG_KEY = (
    "the claim does not fit this reader's zenoh.control_key: give the reader the line that `tactiled serve FILE "
    "--key ROBOT` prints for its robot"
)
USED = (
    f"the claim's challenge was used before, is not this reader's, or is older than {CHALLENGE_S:g} s: try again"
)


HeaderText = Annotated[str, Field(max_length=300)]


class Question(BaseModel):
    """What a request that comes over Zenoh says of itself, beside its claim."""

    method: Literal["GET", "POST", "PUT", "DELETE"] = "GET"
    query: Annotated[str, Field(max_length=4096)] = ""
    headers: dict[Annotated[str, Syntax("accept|content-type", "accept or content-type")], HeaderText] = {}


def robot_key(fleet_key: str, robot: str) -> str:
    """A robot's own key (64 hex digits), from which neither the fleet's nor another robot's follows."""
    return _digest(fleet_key, f"tactiled robot {robot}")


def sign(key: str, place: str, about: dict[str, Any], body: bytes) -> str:
    """The signature of a request at a key of Zenoh, or of the answer to a challenge (HMAC, RFC 2104)."""
    return _digest(key, json.dumps([place, about, sha256(body).hexdigest()], sort_keys=True))


def fits(key: str, place: str, about: dict[str, Any], body: bytes) -> bool:
    """Whether `about` has the signature of all else, as its `claim`."""
    rest = {name: value for name, value in about.items() if name != "claim"}
    return hmac.compare_digest(str(about.get("claim")).encode(), sign(key, place, rest, body).encode())


def _digest(key: str, text: str) -> str:
    return hmac.digest(bytes.fromhex(key), text.encode(), "sha256").hex()


class Gate:
    """Lets changes in at one publisher: those with a claim by its key."""

    def __init__(self, key: str | None) -> None:
        self._key, self._own_key = key, secrets.token_hex(32)
        self._used: dict[str, float] = {}  # challenges, and s, monotonic, when each was issued
        self._lock = threading.Lock()

    def challenge(self, now: float) -> str:
        """A new one at `now` (s, monotonic); it holds its own signature, so that to ask for many costs nothing."""
        issued = f"{now:.6f} {secrets.token_hex(8)}"
        return f"{issued} {_digest(self._own_key, issued)}"

    def refusal(self, place: str, about: dict[str, Any], body: bytes, now: float) -> str:
        """Why a request may change nothing; "" where it may, once."""
        if self._key is None:
            return NO_KEY
        if "claim" not in about:
            return NO_CLAIM
        if not fits(self._key, place, about, body):
            return WRONG_KEY
        return "" if self._use(str(about.get("challenge")), now) else USED

    def proven(self, challenge: str, answer: dict[str, Any], body: bytes) -> dict[str, Any]:
        """The head of the answer to a request that was let in, with its signature."""
        assert self._key is not None
        return answer | {"claim": sign(self._key, challenge, answer, body)}

    def _use(self, challenge: str, now: float) -> bool:
        issued, _, signature = challenge.rpartition(" ")
        if not hmac.compare_digest(signature.encode(), _digest(self._own_key, issued).encode()):
            return False
        issued_at = float(issued.partition(" ")[0])
        with self._lock:
            self._used = {each: at for each, at in self._used.items() if now - at <= CHALLENGE_S}
            if now - issued_at > CHALLENGE_S or challenge in self._used:
                return False
            self._used[challenge] = issued_at
        return True
