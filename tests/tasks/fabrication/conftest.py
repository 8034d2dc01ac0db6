"""The kit of the crane, shared by several files."""

import pytest

from tasks.fabrication.kit import Kit, build_kit
from tasks.fabrication.kit_settings import KitSettings


@pytest.fixture(scope="session")
def kit(crane) -> Kit:
    return build_kit(crane, KitSettings())
