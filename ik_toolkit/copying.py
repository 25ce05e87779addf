"""Base classes for copying and pickling (or for the error that says why it is impossible), and for read-only attributes."""

import copy
import pickle
from collections.abc import Mapping
from typing import Any, ClassVar, Self

from .errors import InvalidOption, ReadOnlyAttribute


def importable(value: Any, what: str) -> None:
    """Raise InvalidOption, "WHAT cannot be pickled", for a function or class that cannot be imported by its name."""
    try:
        pickle.dumps(value)
    except Exception as error:
        where = "defined at the top of a module, another process finds it"
        raise InvalidOption(f"{what} cannot be pickled ({error}); {where}") from None


class Holds:
    """Base of objects that hold a function given by the user.

    They can always be copied, and can be pickled if another process finds the function.
    """

    FUNCTION = ""  # name of the attribute that holds the function

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes."""
        return vars(self).copy()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set all attributes of a copy."""
        vars(self).update(state)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return a copy that shares nothing with the original."""
        made = memo[id(self)] = type(self).__new__(type(self))
        made.__setstate__(copy.deepcopy(self.__getstate__(), memo))
        return made

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Return the pickled form; raise InvalidOption if another process would not find the function."""
        if self.FUNCTION:
            importable(getattr(self, self.FUNCTION), f"the {self.FUNCTION} of this {type(self).__name__.lower()}")
        return super().__reduce_ex__(protocol)


class CopiesViews(Holds):
    """Base of objects that keep arrays ("blocks") and views of parts of them.

    A copy gets its own arrays, of which `_cut` makes the views. `copy.copy` shares only what does not change; for a tracker
    that is the robot and the obstacles.
    """

    VIEWS: tuple[str, ...] = ()  # names of the attributes that `_cut` sets
    SHARED: tuple[str, ...] = ()  # names of the attributes that a shallow copy shares with the original

    def _cut(self) -> None:
        """Make the views of the arrays."""
        raise NotImplementedError

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes but the views."""
        return {name: value for name, value in vars(self).items() if name not in self.VIEWS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set all attributes of a copy, and make its views."""
        super().__setstate__(state)
        self._cut()

    def __copy__(self) -> Self:
        """Return a copy that shares only what does not change."""
        kept = [getattr(self, name) for name in self.SHARED]
        return self.__deepcopy__({id(one): one for one in kept if one is not None})


class Unique:
    """Base of objects that belong to a window or a server of this process, and therefore cannot be copied."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Raise InvalidOption, which says that there can be no copy."""
        raise InvalidOption(f"a {type(self).__name__} cannot be copied or pickled: make another one")


class ReadOnly:
    """Base of objects whose public attributes cannot be assigned once they are sealed.

    An assignment would have no effect on what was computed from the attribute before. Names with an underscore can be assigned.
    """

    __slots__ = ()
    _LOOSE: ClassVar[tuple[str, ...]] = ()  # public attributes that can be assigned even when sealed
    # what the error message advises, by attribute; "" is for all that are not listed
    _INSTEAD: ClassVar[Mapping[str, str]] = {"": "make a new one"}
    _sealed = False

    def _seal(self) -> None:
        """Seal the object: from now on assignments are refused."""
        vars(self)["_sealed"] = True

    def _put(self, **values: Any) -> None:
        """Set attributes of a sealed object from inside the package."""
        vars(self).update(values)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute. Raises ReadOnlyAttribute if the object is sealed and the attribute public."""
        if name[0] != "_" and self._sealed and name not in self._LOOSE:
            kind = type(self).__name__
            instead = self._INSTEAD.get(name, self._INSTEAD.get("", ""))
            raise ReadOnlyAttribute(f"{name} of a {kind} cannot be assigned; {instead}")
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        """Delete an attribute. Raises ReadOnlyAttribute if the object is sealed and the attribute public."""
        if name[0] != "_" and self._sealed and name not in self._LOOSE:
            raise ReadOnlyAttribute(f"{name} of a {type(self).__name__} cannot be deleted")
        object.__delattr__(self, name)
