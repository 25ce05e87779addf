"""Parsing of numbers and values that a user typed, and conversion of results to JSON."""

import json
import math
from typing import Any

from .errors import InvalidOption, InvalidTarget


def numbers(text: str) -> list[float] | None:
    """Return the numbers in a text such as '1 2', '1,2' or '1', None if there are none or there is anything else."""
    try:
        return [float(part) for part in text.replace(",", " ").split()] or None
    except ValueError:
        return None


def vector(text: str, what: str, size: int | None = None) -> list[float]:
    """Return the numbers in a text.

    Raises:
        InvalidOption: There are none; the message names `what`.
        InvalidTarget: There are not `size` of them.
    """
    values = numbers(text)
    if size is None and values is None:
        raise InvalidOption(f"{what} takes numbers, not '{text.strip()}'")
    if size is not None and (values is None or len(values) != size):
        found = f", not '{text.strip()}'" if values is None else f"; got {len(values)}"
        raise InvalidTarget(f"{what} takes {size} numbers{found}")
    return values or []


def parameter(name: str, text: str) -> Any:
    """Return a value from its text: a number, True or False, a list such as [1, 2], or a word.

    Raises InvalidOption, which names the parameter, for anything else.
    """
    for read in (int, float, json.loads):
        try:
            return read(text.lower() if text in ("True", "False") else text)
        except ValueError:
            continue
    if not text.replace("_", "").replace("-", "").isalnum():
        raise InvalidOption(f"parameter '{name}' takes a number or a list like [1, 2], not '{text}'")
    return text


def plain(value: Any) -> Any:
    """Convert arrays, paths and enums to types that JSON has; numbers that are not finite become None (null)."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # an array or a number of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | int | bool) or value is None:
        return value
    return str(value)
