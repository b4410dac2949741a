"""The words for the knowledge that a decoder has of the speed of a picture."""

from typing import Any, Literal

DecoderSpeed = Literal["unknown", "found", "known"]
"""The knowledge that a decoder has of the speed of a picture."""
DecoderWord = Literal[DecoderSpeed, "told"]
"""The same in files and scripts, which may hold the older word for the last."""


def as_decoder_speed(word: Any) -> Any:
    """The word of today for a decoder's knowledge; files and stores may hold an older one."""
    return "known" if isinstance(word, str) and word == "told" else word
