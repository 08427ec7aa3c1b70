import json

from tactiled.interop.zenoh.signatures import CHALLENGE_S, NO_CLAIM, NO_KEY, USED, WRONG_KEY, Gate, robot_key, sign

FLEET, PLACE, BODY = "0f" * 32, "tactiled/r1/palm/0011223344556677/rest/tare", b"{}"
KEY = robot_key(FLEET, "r1")


def about(gate, now=0.0, key=KEY, place=PLACE, body=BODY, **changes):
    """What a server sends with a request."""
    made = {"method": "POST", "query": "", "headers": {}, "challenge": gate.challenge(now)} | changes
    return made | {"claim": sign(key, place, made, body)}


def test_a_claim_holds_once_for_its_request_alone_and_not_for_long():
    gate = Gate(KEY)
    request = about(gate)
    assert gate.refusal(PLACE, request, BODY, CHALLENGE_S) == ""
    assert gate.refusal(PLACE, request, BODY, CHALLENGE_S) == USED
    assert gate.refusal(PLACE, about(gate), BODY, CHALLENGE_S + 0.1) == USED
    assert gate.refusal(PLACE, about(Gate(KEY)), BODY, 0.0) == USED  # before the reader was started again
    for challenge in ("", "1.0 a", "nan a b", "\u20ac", "x" * 10_000):
        assert gate.refusal(PLACE, about(gate, challenge=challenge), BODY, 0.0) == USED
    assert gate.refusal(PLACE.replace("r1", "r2"), about(gate), BODY, 0.0) == WRONG_KEY
    assert gate.refusal(PLACE, about(gate), b"[]", 0.0) == WRONG_KEY
    assert gate.refusal(PLACE, about(gate) | {"query": "force=true"}, BODY, 0.0) == WRONG_KEY
    assert gate.refusal(PLACE, about(gate) | {"method": "DELETE"}, BODY, 0.0) == WRONG_KEY
    for claim in ("", None, 7, [], "\u20ac", sign(FLEET, PLACE, {}, BODY)):
        assert gate.refusal(PLACE, about(gate) | {"claim": claim}, BODY, 0.0) == WRONG_KEY


def test_neither_key_nor_claim_follow_from_what_others_have():
    gate = Gate(KEY)
    for key in (FLEET, robot_key(FLEET, "r2"), robot_key(KEY, "r1")):
        assert gate.refusal(PLACE, about(gate, key=key), BODY, 0.0) == WRONG_KEY
    assert gate.refusal(PLACE, {"method": "POST"}, BODY, 0.0) == NO_CLAIM
    assert Gate(None).refusal(PLACE, about(gate), BODY, 0.0) == NO_KEY
    assert KEY not in json.dumps(about(gate))


def test_whoever_asks_for_challenges_takes_no_memory():
    gate = Gate(KEY)
    for _ in range(1000):
        gate.challenge(0.0)
        gate.refusal(PLACE, about(gate, key=FLEET), BODY, 0.0)
    assert not gate._used
    for now in range(100):
        assert gate.refusal(PLACE, about(gate, float(now)), BODY, float(now)) == ""
    assert len(gate._used) <= CHALLENGE_S + 1
