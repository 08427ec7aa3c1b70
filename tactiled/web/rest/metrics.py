"""`GET /metrics`: every sensor's health and counts in Prometheus's text format, version 0.0.4."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import get_args

from fastapi import APIRouter, Request, Response

from tactiled.bus.error_frames import KINDS
from tactiled.runtime.sensor import Sensor, State, Status
from tactiled.runtime.service import Service
from tactiled.web.http.limits import ConcurrencyLimit
from tactiled.web.http.places import Places
from tactiled.web.rest.common import Served

MEDIA = "text/plain; version=0.0.4; charset=utf-8"
Sample = tuple[dict[str, str], float | None]  # labels; None where there is no value now

router = APIRouter(include_in_schema=False)


@router.get("/metrics")
def metrics(request: Request, service: Served) -> Response:
    """Health and counts, for Prometheus to scrape."""
    state = request.app.state
    return Response(text(service, state.streams, state.places), media_type=MEDIA)


def text(service: Service, streams: ConcurrencyLimit, places: Places) -> str:
    """Every family of a service, its streams and its connections."""
    told = [(each, each.status()) for each in service.sensors.values()]
    return "".join(line + "\n" for family in (*_families(told), *_clients(streams, places)) for line in family)


def _families(told: list[tuple[Sensor, Status]]) -> Iterator[Iterator[str]]:
    def by_sensor(field: str) -> list[Sample]:
        return [({"sensor": sensor.name}, getattr(status, field)) for sensor, status in told]

    states = [
        ({"sensor": sensor.name, "state": state}, float(state == status.state))
        for sensor, status in told
        for state in get_args(State)
    ]
    yield _family("state", "gauge", "1 for the present state of the sensor, else 0", states)
    yield _family("age_seconds", "gauge", "time since the last frame", by_sensor("age_s"))
    yield _family("rate_hertz", "gauge", "frames per second", by_sensor("rate_hz"))
    yield _family(
        "jitter_seconds", "gauge", "standard deviation of the last 100 frame periods", by_sensor("jitter_s")
    )
    yield _family(
        "skew_seconds", "gauge", "time from first to last message of the newest frame", by_sensor("skew_s")
    )
    lost = [
        ({"sensor": sensor.name, "kind": kind}, count)
        for sensor, status in told
        for kind, count in asdict(status.loss).items()
    ]
    yield _family("loss_total", "counter", "losses on the way in, by kind", lost)
    buses = {sensor.plan.bus: status.errors for sensor, status in told}
    errors = [({"bus": bus, "kind": kind}, counts.get(kind, 0)) for bus, counts in buses.items() for kind in KINDS]
    yield _family("error_frames_total", "counter", "error frames of the bus, by kind", errors)


def _clients(streams: ConcurrencyLimit, places: Places) -> Iterator[Iterator[str]]:
    yield _family("streams", "gauge", "open WebSockets", [({}, streams.open)])
    refused: list[Sample] = [({"bound": bound}, count) for bound, count in streams.refused.items()]
    yield _family("streams_refused_total", "counter", "refused WebSockets, by the bound that was reached", refused)
    yield _family("connections", "gauge", "open connections, with WebSockets", [({}, places.open)])
    dropped: list[Sample] = [({"how": how}, count) for how, count in places.dropped.items()]
    yield _family("connections_dropped_total", "counter", "connections above the bound, by what was done", dropped)


def _family(name: str, kind: str, says: str, samples: Iterable[Sample]) -> Iterator[str]:
    yield f"# HELP tactiled_{name} {says}"
    yield f"# TYPE tactiled_{name} {kind}"
    for labels, value in samples:
        if value is not None:
            told = ",".join(f'{label}="{_escaped(each)}"' for label, each in labels.items())
            yield f"tactiled_{name}{f'{{{told}}}' if told else ''} {value!r}"


def _escaped(value: str) -> str:
    return value.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
