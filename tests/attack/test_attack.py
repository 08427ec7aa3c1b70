"""Every attack at a short setting; `python -m tests.attack` runs them at length."""

from collections.abc import Iterator

import pytest

from tests.attack.attacks import ATTACKS
from tests.attack.harness import Size, attack, report
from tests.attack.service import DESCRIPTORS_256, HTTP, TLS, Pool


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    made = Pool()
    made.prepare(HTTP, DESCRIPTORS_256, TLS)
    yield made
    made.close()


@pytest.mark.parametrize("name", ATTACKS)
def test_the_service_holds(name: str, pool: Pool) -> None:
    outcome = attack(name, ATTACKS[name], pool, Size())
    assert not outcome.findings.failures, report(outcome)
