"""What a bus's settings say without their secrets: for whoever may see images."""

import re
from typing import Any

HIDDEN = "hidden"
SECRET = re.compile(  # in names of settings; pin, but neither pinky nor mapping
    "token|pass|pwd|secret|key|credential|auth|pincode|pin(?![a-z])", re.IGNORECASE
)
LOGIN = re.compile(r"(?<=://)[^/?#\s]*(?=@)")  # in an address
QUERY = re.compile(r"([?&][^=&#\s]*=)[^&#\s]+")  # of an address: what it asks for and the value


def hide(text: str) -> str:
    """A text, each address in it without its login and the values of its query."""
    return QUERY.sub(rf"\1{HIDDEN}", LOGIN.sub(HIDDEN, text))


def bare(setting: Any) -> Any:
    """A setting, or a table or list of them, without its secrets."""
    if isinstance(setting, dict):
        return {key: HIDDEN if SECRET.search(str(key)) else bare(value) for key, value in setting.items()}
    if isinstance(setting, list | tuple):
        return [bare(each) for each in setting]
    return hide(setting) if isinstance(setting, str) else setting
