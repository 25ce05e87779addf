"""A base class of objects whose public attributes cannot be assigned once they are built."""

from collections.abc import Mapping
from typing import Any, ClassVar

from .errors import ReadOnlyAttribute


class ReadOnly:
    """Base of objects whose public attributes cannot be assigned once they are sealed.

    What was made from the attribute earlier would not change. Names with an underscore can still be assigned.
    """

    __slots__ = ()
    _LOOSE: ClassVar[tuple[str, ...]] = ()  # public names that can still be assigned
    _INSTEAD: ClassVar[Mapping[str, str]] = {"": "make a new one"}  # advice in the error, by name
    _sealed = False

    def _seal(self) -> None:
        """Seal the object: from now on assignments are refused."""
        self._sealed = True

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
