"""What Accept and If-None-Match headers say."""


def like(part: str) -> tuple[float, str]:
    """How much a part of an Accept header likes which media type."""
    media, *parameters = (each.strip().lower() for each in part.split(";"))
    weight = next((each[2:] for each in parameters if each.startswith("q=")), "1")
    return (float(weight) if weight.isascii() and weight.replace(".", "", 1).isdigit() else 0.0), media


def named(tag: str, header: str) -> bool:
    """Whether an If-None-Match header names a tag; weak and strong ones are the same there."""
    tags = {each.strip().removeprefix("W/") for each in header.split(",")}
    return bool(tags & {tag.removeprefix("W/"), "*"})
