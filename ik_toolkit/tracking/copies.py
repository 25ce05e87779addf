"""How a tracker is copied and pickled, also in the middle of a motion: the copy goes on as the original would, by itself."""

import copy
import pickle
from typing import Any, Self

from ..errors import InvalidOption


class Copied:
    """Something that keeps views of blocks of numbers: its copy has blocks of its own, of which `_cut` takes the views.

    `copy.copy` shares only what the motion does not change: the robot, and the things around it.
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
        """Take what a copy was given."""
        vars(self).update(state)
        self._cut()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy that shares nothing."""
        made = memo[id(self)] = type(self).__new__(type(self))
        made.__setstate__(copy.deepcopy(self.__getstate__(), memo))
        return made

    def __copy__(self) -> Self:
        """A copy that shares what does not change."""
        kept = [getattr(self, name) for name in self.SHARED]
        return self.__deepcopy__({id(one): one for one in kept if one is not None})


def importable(value: Any, what: str) -> None:
    """Raise InvalidOption, "WHAT ...", for a function or class of the caller's that another process would not find."""
    try:
        pickle.dumps(value)
    except Exception as error:
        where = "at the top of a module, where another process finds it"
        raise InvalidOption(f"{what} cannot be pickled ({error}); define it {where}") from None
