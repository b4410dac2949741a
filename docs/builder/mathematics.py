"""A Markdown extension that turns TeX into MathML, so that pages need no script for it.

Inline formulae stand between single dollars, others in a fence named `math`, as forges show them.
"""

import re
from typing import Any

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor

INLINE = r"(?<![\\$\w])\$(?=\S)([^$]+?)(?<=\S)\$(?![\w$])"
_BAR = re.compile('<mo(?: stretchy="false")?>&#x0007C;</mo>')
"""A bar of an absolute value. By itself it counts as a relation, with room on both sides."""
_BEFORE_BACKTICKS = 189
"""Code is found first (190), escapes later (180): a backslash of TeX is no escape."""


class _Inline(InlineProcessor):
    def handleMatch(self, m: Any, data: str) -> tuple[str, int, int]:  # type: ignore[override]
        return self.md.htmlStash.store(_mathml(m.group(1), "inline")), m.start(0), m.end(0)


class _Mathematics(Extension):
    def extendMarkdown(self, md: Markdown) -> None:
        md.inlinePatterns.register(_Inline(INLINE, md), "mathematics", _BEFORE_BACKTICKS)


def fence(source: str, *_: Any, **__: Any) -> str:
    """A formula on lines of its own, as a custom fence of `pymdownx.superfences`."""
    return f'<div class="formula">{_mathml(source, "block")}</div>'


def makeExtension(**_: Any) -> Extension:
    """The extension."""
    return _Mathematics()


def _mathml(source: str, display: str) -> str:
    text = convert(" ".join(source.split()), display=display)
    if "\\" in text:
        raise ValueError(f"a formula must hold commands that can be converted; got `{source}`.")
    return _BAR.sub(r'<mo form="prefix" stretchy="false">&#x0007C;</mo>', text)
