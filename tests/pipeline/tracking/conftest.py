"""In the tests of the mirror MLflow makes its databases itself."""

from collections.abc import Iterator

import pytest
from database_template import own_databases


@pytest.fixture(scope="module", autouse=True)
def made_databases() -> Iterator[None]:
    with own_databases():
        yield
