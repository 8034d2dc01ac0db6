"""Errors that a user can correct."""

import re


class PuddleError(Exception):
    """An error that a user can correct.

    The message names what is wrong and where, what was expected and what was found, and what to do. The command line
    prints it and exits with 2. For any other exception, a bug in puddle, it prints the traceback and exits with 70.
    """


class DamagedArtifact(PuddleError):  # noqa: N818 (a state, not a fault)
    """A file is not what puddle wrote.

    If it is of an item of the store, and (stage, key) is discarded, the item can be computed again.
    """

    def __init__(self, message: str, *, stage: str | None = None, key: str | None = None) -> None:
        super().__init__(message)
        self.stage, self.key = stage, key


class OtherVersion(PuddleError):  # noqa: N818
    """A document has a schema version that this puddle does not read."""


class Irreproducible(PuddleError):  # noqa: N818
    """The same work gave different bytes than before: a bug in puddle or a faulty machine."""


def without_password(text: str) -> str:
    """Return a text without the user and the password of a URI in it."""
    return re.sub(r"(?<=:)//[^/\s]\S*@", "//", text)
