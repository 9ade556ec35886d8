"""The switch that renews golden answers, and the answers that a test is held against."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from golden_answers import Answers


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--renew", metavar="SENTENCE", help="replace the golden answers of the tests that run; the sentence says why"
    )


@pytest.fixture(scope="session")
def golden(request: pytest.FixtureRequest) -> Iterator[Answers]:
    """The stored answers; written at the end of the session where they are renewed."""
    why = request.config.getoption("--renew", default=None) or ""
    if why and hasattr(request.config, "workerinput"):
        pytest.exit("--renew: answers are written by one process: leave out -n", returncode=4)
    answers = Answers(why)
    yield answers
    answers.write()
