"""Every attack at a short setting; `python -m tests.attack` runs them at length."""

import pytest

from tests.attack.conftest import OUTCOMES
from tests.attack.harness import Size, held
from tests.attack.names import ATTACKS
from tests.attack.service import Pool


@pytest.mark.parametrize("name", ATTACKS)
def test_the_service_holds(name: str, pool: Pool) -> None:
    outcome = held(ATTACKS[name], pool, Size())
    OUTCOMES.append(outcome)
    assert outcome.failures == []
