"""Numbers with errors, and reasons for which there is none."""

from typing import NamedTuple


class Estimate(NamedTuple):
    """A number with its error."""

    value: float  # The number
    error: float  # Its standard deviation


class Refusal(NamedTuple):
    """A number that a clip does not tell."""

    number: str  # The number, in words
    reason: str  # The sign that forbids it
    remedy: str  # A way to record a clip that tells it

    @property
    def text(self) -> str:
        """The refusal as a sentence."""
        return f"{self.number} is not known: {self.reason}. {self.remedy}."
