"""How things are copied and pickled: rightly, or not at all with an error that says why."""

import copy
import pickle
from typing import Any, Self

from .errors import InvalidOption


def importable(value: Any, what: str) -> None:
    """Raise InvalidOption, "WHAT ...", for a function or class of the caller's that another process would not find."""
    try:
        pickle.dumps(value)
    except Exception as error:
        where = "defined at the top of a module, another process finds it"
        raise InvalidOption(f"{what} cannot be pickled ({error}); {where}") from None


class Holds:
    """Something that holds a function of the caller's: copied in any case, pickled if another process finds the function."""

    FUNCTION = ""  # name of the attribute

    def __getstate__(self) -> dict[str, Any]:
        """All attributes."""
        return vars(self).copy()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what a copy was given."""
        vars(self).update(state)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy that shares nothing."""
        made = memo[id(self)] = type(self).__new__(type(self))
        made.__setstate__(copy.deepcopy(self.__getstate__(), memo))
        return made

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Raise InvalidOption where the function would not be found."""
        if self.FUNCTION:
            importable(getattr(self, self.FUNCTION), f"the {self.FUNCTION} of this {type(self).__name__.lower()}")
        return super().__reduce_ex__(protocol)


class CopiesViews(Holds):
    """Something that keeps views of blocks of numbers: its copy has blocks of its own, of which `_cut` takes the views.

    `copy.copy` shares only what does not change: of a tracker the robot, and the things around it.
    """

    VIEWS: tuple[str, ...] = ()  # attributes that `_cut` sets
    SHARED: tuple[str, ...] = ()  # attributes that a shallow copy has in common with the original

    def _cut(self) -> None:
        """Take the views."""
        raise NotImplementedError

    def __getstate__(self) -> dict[str, Any]:
        """All but the views."""
        return {name: value for name, value in vars(self).items() if name not in self.VIEWS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what a copy was given, and the views of it."""
        super().__setstate__(state)
        self._cut()

    def __copy__(self) -> Self:
        """A copy that shares what does not change."""
        kept = [getattr(self, name) for name in self.SHARED]
        return self.__deepcopy__({id(one): one for one in kept if one is not None})


class Unique:
    """Something that belongs to a window or a server of this process."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Raise InvalidOption."""
        raise InvalidOption(f"a {type(self).__name__} cannot be copied or pickled: make another one")
