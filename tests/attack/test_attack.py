"""Every attack at a short setting; `python -m tests.attack` runs them at length."""

import pytest

from tests.attack.attacks import ATTACKS
from tests.attack.harness import Size, attack
from tests.attack.service import DESCRIPTORS_256, HTTP, TLS, Pool


@pytest.fixture(scope="module")
def pool():
    with Pool() as pool:
        for kind in (HTTP, DESCRIPTORS_256, TLS):
            pool[kind]  # all begin at once
        yield pool


@pytest.mark.parametrize("name", ATTACKS)
def test_the_service_holds(name, pool):
    findings = attack(ATTACKS[name], pool, Size())
    assert not findings.failures, findings.report(name)
