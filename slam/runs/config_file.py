"""Settings from TOML files and `--set`, with one clear line for each mistake."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from slam.mapping.config import SlamConfig
from slam.runs.errors import ConfigError
from slam.runs.renamed_settings import use_new_names

Model = TypeVar("Model", bound=BaseModel)


def load_config(
    path: Path | None, overrides: Sequence[str] = (), base: SlamConfig | None = None
) -> SlamConfig:
    """Read a TOML file (defaults without one), then apply `section.key=value` overrides.

    With a `base`, its settings stand where neither the file nor an override says otherwise.

    Raises:
        ConfigError: the file cannot be read, or a key or value is not acceptable.
    """
    return load_model(SlamConfig, path, overrides, base.model_dump() if base else None)


def settings_as_overrides(settings: Mapping[str, Any]) -> list[str]:
    """`section.key=value` texts of settings given as Python values."""
    return [f"{key}={_toml(value)}" for key, value in settings.items()]


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return str(value)


def load_model(
    kind: type[Model],
    path: Path | None,
    overrides: Sequence[str] = (),
    base: dict[str, Any] | None = None,
) -> Model:
    """Read a model of any kind as `load_config` does; raises like it."""
    data: dict[str, Any] = base or {}
    if path is not None:
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path}: not valid TOML: {error}") from error
        data = use_new_names(kind, data, str(path))
        _validated(kind, data, str(path))  # so that a mistake in the file is not blamed on --set
    for override in overrides:
        one: dict[str, Any] = {}
        _apply(one, override)
        _merge(data, use_new_names(kind, one, "--set"), override)
    return _validated(kind, data, "--set")


def _validated(kind: type[Model], data: dict[str, Any], where: str) -> Model:
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{where}: {describe(error, kind)}") from error


def _apply(data: dict[str, Any], override: str) -> None:
    """Put one `section.key=value` into nested tables; the value is TOML, or else a bare word."""
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"--set {override!r}: expected section.key=value")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    *sections, name = key.strip().split(".")
    table = data
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise ConfigError(f"--set {override!r}: {section} is not a section")
    table[name] = value


def _merge(data: dict[str, Any], one: Mapping[str, Any], override: str) -> None:
    for name, value in one.items():
        known = data.get(name)
        if isinstance(value, dict):
            if known is not None and not isinstance(known, dict):
                raise ConfigError(f"--set {override!r}: {name} is not a section")
            _merge(data.setdefault(name, {}), value, override)
        else:
            data[name] = value


def _section_note(kind: type[BaseModel], location: str) -> str:
    """What a section must hold, in brackets; nothing for a single setting."""
    field = kind.model_fields.get(location)
    section = section_model(field.annotation) if field is not None else None
    if section is None:
        return ""
    needed = [name for name, one in section.model_fields.items() if one.is_required()]
    return f" (a section: write [{location}], and {', '.join(needed)} in it)"


def describe(error: ValidationError, kind: type[BaseModel] = SlamConfig) -> str:
    """The first problem in one line; for an unknown key, the nearest known one of `kind`."""
    # An unknown name first: it may be the one that is missing, with a slip in it.
    first = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
    location = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"unknown setting {location}{nearest(location, known_keys(kind))}"
    if first["type"] == "missing":
        return f"{location}{_section_note(kind, location)} is missing: it has no usual value"
    if first["type"] == "model_type":
        return f"{location} is a section: set {location}.NAME (got {first['input']!r})"
    if first["type"] == "value_error":  # of several settings together
        return f"{location}: {first['ctx']['error']}"
    return f"{location}: {first['msg']} (got {first['input']!r})"


def section_model(annotation: Any) -> type[BaseModel] | None:
    """The model of a section, which may be left out where it is optional; None for a setting."""
    for kind in (annotation, *get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


def known_keys(model: type[BaseModel], prefix: str = "") -> list[str]:
    """Dotted names of every setting below a model."""
    keys = []
    for name, field in model.model_fields.items():
        if field.exclude:  # filled in from another setting
            continue
        keys.append(prefix + name)
        kind = section_model(field.annotation)
        if kind is not None:
            keys += known_keys(kind, f"{prefix}{name}.")
    return keys


def nearest(name: str, known: Sequence[str]) -> str:
    """A hint at the known name that is most like an unknown one; empty if none is near."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.3)
    return f"; did you mean {near[0]}?" if near else ""
