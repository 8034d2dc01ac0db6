"""What goes wrong in a way that a user can mend."""


class PuddleError(Exception):
    """A mistake or a mishap that a user can mend.

    Its message says what is wrong and where, what was expected and what came, and what to do. The command line prints
    the message alone and exits with 2; any other exception is a defect of puddle, shown with its traceback: 70.
    """


class DamagedArtifact(PuddleError):  # noqa: N818 (what it is, not that it went wrong)
    """Something in the store is not what was committed.

    Attributes:
        stage: the damaged item's stage, or None where the damage is not in an item.
        key: the damaged item's key, or None likewise. Discarding (stage, key) lets the item be computed again.
    """

    def __init__(self, message: str, *, stage: str | None = None, key: str | None = None) -> None:
        super().__init__(message)
        self.stage = stage
        self.key = key


class OtherVersion(PuddleError):  # noqa: N818
    """A document of our own, of a version that this puddle does not read."""


class Irreproducible(PuddleError):  # noqa: N818
    """The same work gave other bytes than before: a defect, and reported as one."""
