"""Errors that a user can mend."""


class PuddleError(Exception):
    """An error that a user can mend.

    The message says what is wrong and where, what was expected and what was received, and what to do. The command line
    prints the message alone and exits with 2. Any other exception is a defect of puddle: a traceback and exit code 70.
    """


class DamagedArtifact(PuddleError):  # noqa: N818 (names the state of an artifact)
    """A file in the store differs from what was committed.

    Attributes:
        stage: stage of the damaged item; None if the damage is not in an item.
        key: key of the damaged item, or None. Discarding (stage, key) lets the item be computed again.
    """

    def __init__(self, message: str, *, stage: str | None = None, key: str | None = None) -> None:
        super().__init__(message)
        self.stage = stage
        self.key = key


class OtherVersion(PuddleError):  # noqa: N818
    """A document of puddle's in a version that this puddle does not read."""


class Irreproducible(PuddleError):  # noqa: N818
    """Computing a work item again gave other bytes, which is a defect."""
