"""`python -m slam.cli.config_reference`: the page that lists every setting, from the models."""

from __future__ import annotations

import re
import types
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from slam.mapping.config import SlamConfig
from slam.runs.config_file import section_model

HEAD = """# Configuration

Every setting, its default and its limits. This page is made by
`python -m slam.cli.config_reference > docs/configuration.md`; change the models, not the page.

A configuration is a TOML file for `--config`; a single value can be given on the command line
with `--set section.key=value`, which wins over the file. Whatever is not named keeps its default.
An unknown name is refused with the nearest known one. The configuration that was in force is
attached to every `run.mcap`, and `summary.json` holds its hash.

```toml
[keyframes]
method = "constant"
interval = 0.4

[loops]
places = 5
```
"""


def page() -> str:
    """The whole page as Markdown."""
    parts = [HEAD, *_tables(SlamConfig, "")]
    return "\n".join(parts)


def _tables(model: type[BaseModel], section: str) -> Iterator[str]:
    """A table for a model's own settings, then those of its sections."""
    title = f"## `[{section}]`" if section else "## Top level"
    rows = [
        f"| `{name}` | {_default(field)} | {_allowed(field)} | {_cell(field.description or '')} |"
        for name, field in model.model_fields.items()
        if _model(field) is None and not field.exclude
    ]
    if rows:
        about = f"{_first_line(model)}\n\n" if section else ""
        head = "| key | default | allowed | meaning |\n| --- | --- | --- | --- |\n"
        yield f"{title}\n\n{about}{head}" + "\n".join(rows) + "\n"
    for name, field in model.model_fields.items():
        inner = _model(field)
        if inner is not None:
            yield from _tables(inner, f"{section}.{name}".lstrip("."))


def _model(field: FieldInfo) -> type[BaseModel] | None:
    return section_model(field.annotation)


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").strip().splitlines()[0]


def _default(field: FieldInfo) -> str:
    value = field.get_default(call_default_factory=True)
    if value is None:
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def _allowed(field: FieldInfo) -> str:
    kind: Any = field.annotation
    if get_origin(kind) is Literal:
        return ", ".join(f'`"{choice}"`' for choice in get_args(kind))
    if get_origin(kind) is tuple:
        return f"{len(get_args(kind))} numbers"
    if kind is bool:
        return "`true`, `false`"
    if get_origin(kind) is types.UnionType and types.NoneType in get_args(kind):
        return "number, or left out"
    if get_origin(kind) is types.UnionType:
        return " or ".join(str(getattr(k, "__name__", k)) for k in get_args(kind))
    limits = [_limit(limit) for limit in field.metadata]
    word = "whole number" if kind is int else "number" if kind is float else "text"
    return " ".join([word, ", ".join(filter(None, limits))]).strip()


def _limit(limit: object) -> str:
    for kind, word in ((Gt, ">"), (Ge, ">="), (Lt, "<"), (Le, "<=")):
        if isinstance(limit, kind):
            bound = getattr(limit, kind.__name__.lower())
            return f"{word} {bound}"
    return ""


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", r"\|")


if __name__ == "__main__":
    import sys

    sys.stdout.write(page())
