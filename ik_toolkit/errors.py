"""The exceptions of ik_toolkit, with one base class, so that `except IKError` catches every error we report.

Invalid input raises one of these; it names the joint, frame, file or option, lists the valid names and suggests the nearest
match. A numerical outcome (not converged, unreachable, singular) never raises: it is a status in the result.
"""

import difflib
import logging
import math
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

COMPARED = 1_000  # names that a misspelled one is compared with; each takes up to 50 us
SHOWN = 100  # characters of a name that are compared and shown: comparing takes quadratic time
# Characters a terminal acts on instead of showing: C0 and C1 controls except tab and newline, and bidirectional marks.
CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]")
FAR_AWAY = 50.0  # reaches; targets farther away are more often in millimetres
FEW_TURNS = 4.0 * math.pi  # rad; larger angles are more often degrees than turns
DOUBTED: set[str] = set()
EXTRA = re.compile(r"""^([A-Za-z0-9_.-]+).*extra\s*==\s*['"]([a-z]+)['"]""")


def clean(text: object) -> str:
    """Text safe for a terminal: control characters (which come only from names in files) are escaped."""
    return CONTROLS.sub(lambda found: ascii(found[0])[1:-1], str(text))


def rebuild(kind: type[BaseException], args: tuple, state: dict[str, Any]) -> BaseException:
    """An exception as it was, without a call of its constructor, which may take something else than `args`."""
    made = kind.__new__(kind, *args)
    next(base for base in kind.__mro__ if base.__module__ == "builtins").__init__(made, *args)
    made.__dict__.update(state)
    return made


class Portable(BaseException):
    """An exception that can be copied and pickled, so that a worker process can raise it in its caller."""

    def __reduce__(self) -> tuple[Any, ...]:
        """The class, its arguments and all attributes."""
        return rebuild, (type(self), self.args, self.__dict__)


class IKError(Portable, Exception):
    """Base class of every error raised by ik_toolkit."""

    def __str__(self) -> str:
        """Return the message itself (KeyError would quote it), without control characters."""
        return clean(self.args[0]) if self.args else ""


class RobotNotFound(IKError, KeyError):
    """No robot of that name and no file at that path."""


class ModelError(IKError, ValueError):
    """A robot description that cannot be used: broken, hostile or outside what the toolkit handles."""


class FrameNotFound(IKError, KeyError):
    """The model has no frame (link) of that name, or one must be chosen from `tips`."""

    tips: tuple[str, ...] = ()


class JointNotFound(IKError, KeyError):
    """The model has no moving joint of that name."""


class ConfigurationNotFound(IKError, KeyError):
    """The robot has no named configuration of that name."""


class InvalidTarget(IKError, ValueError):
    """A target that is not a finite position or rigid pose."""


class InvalidConfiguration(IKError, ValueError):
    """Joint values of the wrong size, not finite, or outside the limits where that is not allowed."""


class InvalidOption(IKError, ValueError):
    """An option or parameter that does not exist or whose value is out of range."""


class ReadOnlyAttribute(IKError, AttributeError):
    """An attribute that was read when its object was built: assigning it would change nothing. The message says what does."""


class UnknownSolver(IKError, KeyError):
    """No solver of that name, or one that does not fit this robot."""


class MissingExtra(IKError, ImportError):
    """An optional dependency is not installed; the message gives the pip command."""

    def __init__(self, package: str, extra: str) -> None:
        """package: the missing package; extra: the extra whose packages the message lists."""
        needed = " ".join(extras().get(extra, [package]))
        super().__init__(f"{package} is not installed; run: pip install {needed}")
        self.extra = extra


class NotSolved(IKError):
    """Raised by `Result.raise_for_status()` when the solve did not succeed; carries the result."""

    def __init__(self, result) -> None:
        """Keep the result along with its message."""
        super().__init__(f"{result.status.name}: {result.message}")
        self.result = result


def floats(value: Any, what: str, error: type[IKError], kinds: str = "fiu") -> "np.ndarray":
    """Return real numbers as a new float64 array in C order; kinds: numpy's kind letters that are accepted.

    Raises `error`, "WHAT, not VALUE", for everything else: strings, booleans, dates, complex numbers and objects, which numpy
    might convert to some number, and masked entries.
    """
    import numpy as np  # keeps `import ik_toolkit` light

    try:
        if not masked(value) and (array := np.array(value, order="C")).dtype.kind in kinds:
            return array.astype(float, order="C", copy=False)
    except (TypeError, ValueError, OverflowError):
        pass
    raise error(f"{what}, not {' '.join(repr(value).split())[:120]}")


def whole(value: Any, what: str, least: int = 1) -> int:
    """Return a whole number of at least `least`, 3.0 as 3. Raises InvalidOption, "WHAT must be ..., not VALUE"."""
    what = f"{what} must be a whole number of at least {least}"
    number = floats(value, what, InvalidOption)
    if number.shape != () or not number >= least or number % 1.0 != 0.0:
        raise InvalidOption(f"{what}, not {value!r:.60}")
    return int(number)


def check_progress(progress: Any, of: str) -> None:
    """Raise InvalidOption unless `progress` is None or can be called; of: what it is called with."""
    if progress is not None and not callable(progress):
        raise InvalidOption(f"progress must be a function of {of}, not {progress!r:.60}")


def masked(value: Any) -> bool:
    """Whether an array, or an array inside a list, has masked entries."""
    import numpy as np  # keeps `import ik_toolkit` light

    if type(value) is np.ndarray:
        return False
    if isinstance(value, list | tuple):
        inner = (list, tuple, np.ndarray)
        return any([masked(item) for item in value if isinstance(item, inner)])
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.is_masked(value))


def doubt_angles(what: str, angles: Mapping[str, float]) -> None:
    """Warn that angles [rad] of several turns, by joint ('' if of none), may have been meant in degrees.

    Once for a joint of one `what`, as it may be in a loop; and once for a joint's value, whatever it is called on its way.
    """
    known = {joint for joint, x in angles.items() if DOUBTED.intersection((f"{what}, {joint}", f"{joint}: {x!r}"))}
    DOUBTED.update(f"{what}, {joint}" for joint in angles)
    new = {joint: x for joint, x in angles.items() if joint not in known}
    if not new:
        return
    DOUBTED.update(f"{joint}: {x!r}" for joint, x in new.items())
    x = max(new.values(), key=abs)
    where = f"{what}, joint{'s' * (len(new) > 1)} {', '.join(new)}" if any(new) else what
    logging.getLogger("ik_toolkit").warning(
        "%s: %g rad is %.3g turns; were degrees meant?", where, x, abs(x) / (2.0 * math.pi)
    )


def doubt_lengths(what: str, away: float, reach: float) -> None:
    """Warn, once for one `what`, that lengths [m] beyond FAR_AWAY reaches may have been meant in millimetres."""
    if away > FAR_AWAY * reach and what not in DOUBTED:
        DOUBTED.add(what)
        logging.getLogger("ik_toolkit").warning(
            "%s: %.4g m is %.3g times the robot's reach; were millimetres meant?", what, away, away / reach
        )


def extras() -> dict[str, list[str]]:
    """Packages by extra, from the requirements of the installed ik_toolkit; empty if it is not installed."""
    import importlib.metadata  # keeps `import ik_toolkit` light

    found: dict[str, list[str]] = {}
    try:
        requirements = importlib.metadata.requires("ik_toolkit") or ()
    except importlib.metadata.PackageNotFoundError:
        return {}
    for match in filter(None, map(EXTRA.match, requirements)):
        if match[1] != "ik_toolkit":
            found.setdefault(match[2], []).append(match[1])
    return found


def nearest(name: object, options: Iterable[str], alike: float = 0.5) -> str | None:
    """The option most like a misspelled name; None when the likeness of all (0 to 1, see `difflib`) is below `alike`."""
    known = [str(option)[:SHOWN] for option, _ in zip(options, range(COMPARED), strict=False)]
    lower = [option.lower() for option in known]
    best = difflib.get_close_matches(str(name)[:SHOWN].lower(), lower, 1, alike)
    return known[lower.index(best[0])] if best else None


def near_match(name: object, options: Iterable[str]) -> str:
    """Return ' Did you mean ...? Available: ...' for an unknown name (a sentence tail for error messages)."""
    known = [str(option)[:SHOWN] for option in options]
    close = nearest(name, known)
    listed = ", ".join(known[:30]) + (f", ... ({len(known)} in all)" if len(known) > 30 else "")
    return (f" Did you mean '{close}'?" if close else "") + (f" Available: {listed}." if known else "")
