"""Hooks of `make docs`: equations become MathML, which browsers draw without any script."""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

_CODE = re.compile(r"(^ *```.*?^ *```|`[^`\n]+`)", re.M | re.S)
_EQUATION = re.compile(r"^( *)\$\$(.+?)\$\$[ ]*$", re.M | re.S)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace `$$ ... $$` on lines of their own, but not in code."""
    parts = _CODE.split(markdown)
    parts[::2] = [_EQUATION.sub(_drawn, part) for part in parts[::2]]
    return "".join(parts)


def _drawn(found: re.Match[str]) -> str:
    return f'{found[1]}<div class="equation">{convert(found[2].strip(), display="block")}</div>'
