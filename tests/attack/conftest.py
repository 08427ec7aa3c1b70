from collections.abc import Iterator

import pytest

from tests.attack.harness import Outcome, table
from tests.attack.service import FEW, PLAIN, SECURE, Pool

OUTCOMES: list[Outcome] = []


@pytest.fixture(scope="session")
def pool() -> Iterator[Pool]:
    made = Pool()
    made.prepare(PLAIN, FEW, SECURE)
    yield made
    made.close()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if OUTCOMES:
        terminalreporter.section("attacks")
        terminalreporter.write_line(table(OUTCOMES))
