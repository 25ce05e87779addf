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
    """Base class of objects that hold a function given by the user, so that they can be copied and pickled.

    Copying always works; pickling works if another process can import the function.
    """

    FUNCTION = ""  # name of the attribute that holds the user's function; a subclass sets it

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
    """Base class of objects that keep arrays, and views of parts of them, so that a copy does not share these.

    A copy gets arrays of its own, and its method `_cut` makes the views of them. `copy.copy` shares only what does not change; for
    a tracker that is the robot and the obstacles.
    """

    VIEWS: tuple[str, ...] = ()  # names of the attributes that are views, which `_cut` sets
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
    """Base class of objects that belong to a window or a server of this process, and therefore cannot be copied."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Raise InvalidOption, which says that there can be no copy."""
        raise InvalidOption(f"a {type(self).__name__} cannot be copied or pickled: make another one")


class ReadOnly:
    """Base class of objects whose public attributes can no longer be assigned once the object is built (sealed).

    What was computed from an attribute would not follow an assignment. Attributes whose name begins with an underscore can be
    assigned.
    """

    __slots__ = ()
    _LOOSE: ClassVar[tuple[str, ...]] = ()  # public attributes that can be assigned even when the object is sealed
    # advice of the error message, by attribute that was assigned; "" stands for all others
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
