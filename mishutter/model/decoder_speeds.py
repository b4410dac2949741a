"""The words for the knowledge that a decoder has of the speed of a picture."""

from typing import Literal

DecoderSpeed = Literal["unknown", "found", "known"]
"""The knowledge that a decoder has of the speed of a picture."""
