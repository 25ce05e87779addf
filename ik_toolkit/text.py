"""Parse typed numbers and values, and convert results to JSON."""

import json
import math
from typing import Any

from .errors import InvalidOption, InvalidTarget


def numbers(text: str) -> list[float] | None:
    """Read the numbers of '1 2', '1,2' or '1'; None if there are none or anything else."""
    try:
        return [float(part) for part in text.replace(",", " ").split()] or None
    except ValueError:
        return None


def vector(text: str, what: str, size: int | None = None) -> list[float]:
    """Read the numbers of `text`. Raises InvalidOption naming `what` if there are none, InvalidTarget if not `size` of them."""
    values = numbers(text)
    if size is None and values is None:
        raise InvalidOption(f"{what} takes numbers, not '{text.strip()}'")
    if size is not None and (values is None or len(values) != size):
        found = f", not '{text.strip()}'" if values is None else f"; got {len(values)}"
        raise InvalidTarget(f"{what} takes {size} numbers{found}")
    return values or []


def parameter(name: str, text: str) -> Any:
    """Read a number, True or False, a list like [1, 2] or a word; InvalidOption, naming the parameter, for anything else."""
    for read in (int, float, json.loads):
        try:
            return read(text.lower() if text in ("True", "False") else text)
        except ValueError:
            continue
    if not text.replace("_", "").replace("-", "").isalnum():
        raise InvalidOption(f"parameter '{name}' takes a number or a list like [1, 2], not '{text}'")
    return text


def plain(value: Any) -> Any:
    """Convert arrays, paths and enums to JSON types; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy array or scalar
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | int | bool) or value is None:
        return value
    return str(value)
