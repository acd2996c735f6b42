"""What all written pages share: templates, style, scripts, and how they write numbers."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markupsafe import Markup

_HERE = Path(__file__).parent


def page_template(name: str) -> Template:
    """The template `name`; the filter `number` writes figures, `asset` embeds a file."""
    environment = Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = format_number
    environment.globals["asset"] = asset
    environment.globals["script_policy"] = script_policy
    return environment.get_template(name)


def asset(name: str) -> Markup:
    """The text of a file that comes with this package."""
    return Markup((_HERE / "assets" / name).read_text(encoding="utf-8"))


def script_policy(names: Sequence[str]) -> str:
    """The scripts that a page may run, by their hashes (W3C Content Security Policy 3).

    Whatever else a foreign log might bring into the page cannot run.
    """
    digests = (hashlib.sha256(asset(name).encode("utf-8")).digest() for name in names)
    return " ".join(f"'sha256-{base64.b64encode(d).decode('ascii')}'" for d in digests)


def format_number(value: Any, decimals: int = 3) -> str:
    """Return a number for people: a dash where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "\N{EN DASH}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:,.{decimals}f}".replace(",", "\N{NARROW NO-BREAK SPACE}")
