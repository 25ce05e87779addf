"""Arguments that several studies share, validated before any work begins."""

from collections.abc import Iterable
from typing import Any

from ..errors import InvalidOption


def solver_list(solvers: Any) -> list[Any]:
    """One solver or several (names, classes or instances) as a list. Raises InvalidOption."""
    if isinstance(solvers, str | type) or hasattr(type(solvers), "loop"):  # an instance of a rule is a tuple, too
        return [solvers]
    if not isinstance(solvers, Iterable):
        raise InvalidOption(f"solvers must be names, rule classes or instances of them, not {solvers!r:.60}")
    return list(solvers)
