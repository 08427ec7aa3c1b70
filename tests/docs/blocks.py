"""What a machine prints into README and guide, between `<!-- begin: NAME -->` and `<!-- end -->`."""

import re
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

from tests.docs import examples, interfaces, settings, words

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"(<!-- begin: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
BLOCKS: dict[str, Callable[[], Iterable[str]]] = {
    "settings": settings.tables,
    "codecs": settings.codecs,
    "codec-settings": settings.codec_tables,
    "routes": interfaces.routes,
    "parameters": interfaces.parameters,
    "metrics": interfaces.metrics,
    "stream-parameters": interfaces.stream_parameters,
    "stream-header": interfaces.stream_header,
    "close-codes": interfaces.close_codes,
    "verbs": interfaces.verbs,
    "loss": words.loss,
    "error-kinds": words.error_kinds,
    "events": words.events,
    "methods": words.methods,
    "reasons": words.reasons,
    "warnings": words.warnings,
    "packed-classic": examples.packed_classic,
    "packed-fd": examples.packed_fd,
    "stream-example": examples.stream_message,
    "check": examples.check,
    "sniff": examples.sniff,
}


def pages() -> list[Path]:
    """README and every page of the guide."""
    return [ROOT / "README.md", *sorted((ROOT / "tactiled/docs").glob("*.md"))]


@cache
def block(name: str) -> str:
    """The lines of one block; KeyError where no block has this name."""
    return "".join(f"{line}\n" for line in BLOCKS[name]())


def printed(page: str) -> str:
    """A page with its blocks printed again."""
    return BLOCK.sub(lambda found: f"{found[1]}{block(found[2])}{found[3]}", page)
