"""Numbers with errors, and reasons for which there is none."""

from typing import NamedTuple


class Estimate(NamedTuple):
    """A number with its error.

    Attributes:
        value: The number.
        error: Its standard deviation.
    """

    value: float
    error: float


class Refusal(NamedTuple):
    """A number that a clip does not tell.

    Attributes:
        number: The number, in words.
        reason: The sign that forbids it.
        remedy: A way to record a clip that tells it.
    """

    number: str
    reason: str
    remedy: str

    @property
    def text(self) -> str:
        """The refusal as a sentence."""
        return f"{self.number} is not known: {self.reason}. {self.remedy}."
