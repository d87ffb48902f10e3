"""Values of capture.toml, and of options given as text, as the types that settings declare: one rule for both."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from typing import Any

from pipeline.errors import UserError, nearest

NAMES: dict[type, str] = {bool: "true or false", int: "a whole number", float: "a number (finite)", str: "text"}
NAMES |= {tuple: "a list", dict: "a table"}
MAY_BE_INFINITE = frozenset({"extinction"})
"""Settings whose ideal is infinite: a polariser's extinction ratio."""
SMALLEST, LARGEST = 1.2e-38, 3.4e38
"""Frames are computed in single precision: a factor beyond it would make them infinite, one below it black."""


def typed(value: Any, kind: Any, key: str, source: str, text: bool = False) -> Any:
    """Check and convert one setting: one rule for capture.toml and the command line.

    Args:
        value: as TOML reads it, where a number is no text and nothing but true and false is a truth value; or with `text` as
            written on a command line, where numbers, true, false and none are spelt out and lists split at commas and spaces.
        kind: bool, int, float, str, Any, a Literal, an optional, a tuple or dict of these, or a dataclass.
        key: the setting's name, for errors.
        source: where it stands, for errors.
        text: the value comes from a command line.

    Returns:
        The value as `kind`; a number with a fraction is no int.

    Raises:
        UserError: the value is not of that type, not one of the choices, or not finite where it must be.
    """
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return value
    if origin is typing.Literal:
        if value not in arguments:
            raise UserError(source, f"{key} = {value!r} is unknown", nearest(str(value), arguments))
        return value
    if origin in (types.UnionType, typing.Union):
        if value is None or (text and str(value).lower() in ("none", "")):
            return None
        return typed(value, next(a for a in arguments if a is not type(None)), key, source, text)
    if dataclasses.is_dataclass(kind):
        return filled(kind, _one_of(value, dict, key, source), f"{key}.", source)
    if origin is dict:
        table = _one_of(value, dict, key, source)
        return {str(k): typed(v, arguments[1], f"{key}.{k}", source, text) for k, v in table.items()}
    if origin is tuple:
        parts = value.replace(",", " ").split() if text and isinstance(value, str) else value
        return tuple(typed(p, arguments[0], f"{key}[{i}]", source, text) for i, p in enumerate(_listed(parts, key, source)))
    return _scalar(value, kind, key, source, text)


def filled(cls: Any, table: dict[str, Any], prefix: str, source: str, hidden: tuple[str, ...] = ()) -> Any:
    """Make a settings dataclass from a TOML table.

    Args:
        cls: the dataclass; its type hints say what each key may be.
        table: key to value, as TOML reads it.
        prefix: of the keys in errors, such as "stokes.".
        source: where the table stands, for errors.
        hidden: fields that are no keys of it.

    Returns:
        An instance; keys that the table lacks keep their defaults.

    Raises:
        UserError: a key is unknown or a value not of its type.
    """
    hints = typing.get_type_hints(cls)
    known = [f.name for f in dataclasses.fields(cls) if f.name not in hidden]
    for key in table:
        if key not in known:
            raise UserError(source, f"unknown key {prefix}{key}", f"known here: {', '.join(known)}")
    return cls(**{key: typed(value, hints[key], f"{prefix}{key}", source) for key, value in table.items()})


def _scalar(value: Any, kind: type, key: str, source: str, text: bool) -> Any:
    if kind is bool:
        if text and str(value).lower() in ("true", "false"):
            return str(value).lower() == "true"
        return _one_of(value, bool, key, source)
    if kind not in (int, float):
        return _one_of(value, kind, key, source)
    try:
        number = float(value) if text and isinstance(value, str) else value
    except ValueError:
        raise _wrong(value, kind, key, source) from None
    infinite = kind is float and key.rpartition(".")[2] in MAY_BE_INFINITE
    if isinstance(number, bool) or not isinstance(number, int | float) or not _is_number(number, infinite):
        raise _wrong(value, kind, key, source)
    if kind is float and number and math.isfinite(number) and not SMALLEST <= abs(number) <= LARGEST:
        fault = f"{key} = {value!r} is not a number that single precision holds ({SMALLEST} to {LARGEST})"
        raise UserError(source, fault, "correct the value")
    if kind is int and not (isinstance(number, int) or number.is_integer()):
        raise _wrong(value, kind, key, source)
    return kind(number)


def _is_number(number: float, infinite: bool) -> bool:
    """Whether a float can hold it: finite, or where it may be also infinite."""
    try:
        return math.isfinite(number) or (infinite and not math.isnan(number))
    except OverflowError:  # an integer beyond any float
        return False


def _one_of(value: Any, kind: type, key: str, source: str) -> Any:
    if not isinstance(value, kind):
        raise _wrong(value, kind, key, source)
    return value


def _listed(value: Any, key: str, source: str) -> list[Any]:
    if not isinstance(value, list | tuple):
        raise _wrong(value, tuple, key, source)
    return list(value)


def _wrong(value: Any, kind: type, key: str, source: str) -> UserError:
    remedy = "write true or false" if kind is bool else "correct the value"
    return UserError(source, f"{key} = {value!r} is not {NAMES.get(kind, f'a {kind.__name__}')}", remedy)
