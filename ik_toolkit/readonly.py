"""Objects whose public attributes stay as they were built."""

from collections.abc import Mapping
from typing import Any, ClassVar

from .errors import ReadOnlyAttribute


class ReadOnly:
    """Once sealed, an object refuses to have a public attribute assigned: what was made from it would not follow.

    _INSTEAD: what to use in place of an assignment, by name ("" for all others). Names with an underscore, and those in
    _LOOSE, stay free.
    """

    __slots__ = ()
    _LOOSE: ClassVar[tuple[str, ...]] = ()

    _INSTEAD: ClassVar[Mapping[str, str]] = {"": "make a new one"}
    _sealed = False

    def _seal(self) -> None:
        """Refuse assignments from now on."""
        self._sealed = True

    def _put(self, **values: Any) -> None:
        """Set attributes of a sealed object, for our own use."""
        vars(self).update(values)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; raises ReadOnlyAttribute for a public one of a sealed object."""
        if name[0] != "_" and self._sealed and name not in self._LOOSE:
            kind = type(self).__name__
            instead = self._INSTEAD.get(name, self._INSTEAD.get("", ""))
            raise ReadOnlyAttribute(f"{name} of a {kind} cannot be assigned; {instead}")
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        """Delete an attribute; raises ReadOnlyAttribute for a public one of a sealed object."""
        if name[0] != "_" and self._sealed and name not in self._LOOSE:
            raise ReadOnlyAttribute(f"{name} of a {type(self).__name__} cannot be deleted")
        object.__delattr__(self, name)
