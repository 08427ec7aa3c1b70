"""The code and the reason of a WebSocket's close frame."""

MOST_REASON = 123  # bytes of a close frame's reason


def code(status: int) -> int:
    """The close code of an HTTP status."""
    return 4000 + status


def fitting(reason: str) -> str:
    """As much of a reason as a close frame holds."""
    return reason.encode()[:MOST_REASON].decode(errors="ignore")
