"""Every attack by its name."""

from tests.attack import abuse, connections, ends, fuzz, load, ports
from tests.attack.harness import Attack
from tests.attack.service import BUSES, FEW, SECURE

_ALL = (
    Attack(connections.upgrades, FEW),
    Attack(connections.empty_frames),
    Attack(connections.trailers),
    Attack(connections.polls),
    Attack(connections.bad_upgrades),
    Attack(connections.slow),
    Attack(abuse.tokens),
    Attack(abuse.strangers),
    Attack(abuse.nonsense),
    Attack(abuse.frames),
    Attack(abuse.handshakes),
    Attack(ports.tls, SECURE, grown_mb=160),  # 0.3 MB for each connection that was open at once
    Attack(ports.foxglove, grown_mb=128),  # two messages of 40 MB
    Attack(ports.foxglove_open, FEW),
    Attack(fuzz.fuzz),
    Attack(load.uploads),
    Attack(load.calls),
    Attack(load.flood),
    Attack(ends.sigterm, alone=True),
    Attack(ends.sigint, SECURE, alone=True),
    Attack(ends.sigkill, BUSES, alone=True),
)
ATTACKS = {each.name: each for each in _ALL}
