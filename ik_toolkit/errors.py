"""The exceptions of ik_toolkit. They have one base class, so `except IKError` catches every error that we report.

Invalid input raises one of them; its message names the joint, frame, file or option, lists the valid names and suggests the
nearest match. A numerical outcome (not converged, unreachable, singular) is not an error but a status in the result.
"""

import difflib
import logging
import math
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

COMPARED = 1_000  # largest number of names with which a misspelled name is compared, at up to 50 us a name
SHOWN = 100  # longest name [characters] that is compared or shown in full; comparing takes quadratic time
# Characters that a terminal acts on instead of showing them: control characters but tab and newline, and bidirectional marks.
CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]")
FAR_AWAY = 50.0  # [arm reaches] A target farther away than this was probably given in millimetres.
FEW_TURNS = 4.0 * math.pi  # [rad] A larger angle was probably given in degrees.
DOUBTED: set[str] = set()  # subjects of all warnings about units so far, so that no warning is repeated
# Matches a requirement of an extra in a package's metadata, such as: scipy>=1.10; extra == "tune".
EXTRA = re.compile(r"""^([A-Za-z0-9_.-]+).*extra\s*==\s*['"]([a-z]+)['"]""")


def clean(text: object) -> str:
    """Return a text with its control characters escaped, so that it can be printed safely even if it comes from a file."""
    return CONTROLS.sub(lambda found: ascii(found[0])[1:-1], str(text))


def rebuild(kind: type[BaseException], args: tuple, state: dict[str, Any]) -> BaseException:
    """Make an exception from its pickled parts, without calling its constructor, whose arguments may differ from `args`."""
    made = kind.__new__(kind, *args)
    next(base for base in kind.__mro__ if base.__module__ == "builtins").__init__(made, *args)
    made.__dict__.update(state)
    return made


class Portable(BaseException):
    """An exception that can be copied and pickled, so that one raised in a worker process reaches the caller."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make the exception again: from its class, arguments and attributes."""
        return rebuild, (type(self), self.args, self.__dict__)


class Interrupted(Portable, KeyboardInterrupt):
    """Base class of the exceptions raised after Ctrl-C during long work; `result` is the result of the part that was finished."""

    def __init__(self, result: Any, done: str | None = None) -> None:
        """Keep the result of the finished part; done: how much was done, for the message (default: the message of the result)."""
        super().__init__(f"interrupted: {result.message}" if done is None else f"interrupted {done}")
        self.result = result


class IKError(Portable, Exception):
    """Base class of every error raised by ik_toolkit."""

    def __str__(self) -> str:
        """Return the message without control characters, and without the quotes that KeyError adds."""
        return clean(self.args[0]) if self.args else ""


class RobotNotFound(IKError, KeyError):
    """There is no robot of that name, and no file at that path."""


class ModelError(IKError, ValueError):
    """A robot description cannot be used: it is broken, malicious, or has a feature that the toolkit does not support."""


class FrameNotFound(IKError, KeyError):
    """The model has no frame (link) of that name, or has several possible tips and none was named.

    Attributes:
        tips: Names to choose from, if none was named.
    """

    tips: tuple[str, ...] = ()


class JointNotFound(IKError, KeyError):
    """The model has no moving joint of that name."""


class ConfigurationNotFound(IKError, KeyError):
    """The robot has no named configuration of that name."""


class InvalidTarget(IKError, ValueError):
    """A target is not a finite position or a rigid pose."""


class InvalidConfiguration(IKError, ValueError):
    """Joint values have the wrong size, are not finite, or lie outside the limits where that is not allowed."""


class InvalidOption(IKError, ValueError):
    """An option or parameter does not exist, or its value is out of range."""


class ReadOnlyAttribute(IKError, AttributeError):
    """An attribute was assigned that cannot be changed once its object exists; the message says what to do instead."""


class UnknownSolver(IKError, KeyError):
    """There is no solver of that name, or it does not fit this robot."""


class MissingExtra(IKError, ImportError):
    """An optional dependency is not installed; the message gives the pip command.

    Attributes:
        extra: Name of the extra that installs it.
    """

    def __init__(self, package: str, extra: str) -> None:
        """Make the message from the name of the missing package and of the extra that installs it."""
        needed = " ".join(extras().get(extra, [package]))
        super().__init__(f"{package} is not installed; run: pip install {needed}")
        self.extra = extra


class NotSolved(IKError):
    """A solve did not succeed; `Result.raise_for_status()` raises it.

    Attributes:
        result: The result of the solve.
    """

    def __init__(self, result) -> None:
        """Make the message from a result, and keep the result."""
        super().__init__(f"{result.status.name}: {result.message}")
        self.result = result


def floats(value: Any, what: str, error: type[IKError], kinds: str = "fiu") -> "np.ndarray":
    """Convert a value to a new array of real numbers.

    Args:
        value: A number, a list or an array.
        what: What the value should be, for the message.
        error: Class of the exception to raise.
        kinds: numpy's letters of the kinds of number that are accepted.

    Returns:
        An array of float64 in C order.

    Raises:
        IKError: `error`, "WHAT, not VALUE", for anything else that numpy might convert to a number: strings, booleans, dates,
            complex numbers, objects and masked entries.
    """
    import numpy as np  # imported here so that `import ik_toolkit` stays fast

    try:
        if not masked(value) and (array := np.array(value, order="C")).dtype.kind in kinds:
            return array.astype(float, order="C", copy=False)
    except (TypeError, ValueError, OverflowError):
        pass
    raise error(f"{what}, not {' '.join(repr(value).split())[:120]}")


def whole(value: Any, what: str, least: int = 1) -> int:
    """Return a whole number as an int, also if it is a float such as 3.0.

    Raises InvalidOption, "WHAT must be ..., not VALUE", if it is not a whole number or less than `least`.
    """
    # Only whole numbers that a float represents exactly are accepted, which are those below 2^53.
    if type(value) is int and least <= value < 2**53:
        return value
    what = f"{what} must be a whole number of at least {least}"
    number = floats(value, what, InvalidOption)
    if number.shape != () or not least <= number < math.inf or number % 1.0 != 0.0:
        raise InvalidOption(f"{what}, not {value!r:.60}")
    return int(number)


def check_progress(progress: Any, of: str) -> None:
    """Raise InvalidOption unless `progress` is None or can be called; `of` says what it is called with, for the message."""
    if progress is not None and not callable(progress):
        raise InvalidOption(f"progress must be a function of {of}, not {progress!r:.60}")


def masked(value: Any) -> bool:
    """Return whether an array, or an array inside a list, has masked entries."""
    import numpy as np  # imported here so that `import ik_toolkit` stays fast

    if type(value) is np.ndarray:
        return False
    if isinstance(value, list | tuple):
        inner = (list, tuple, np.ndarray)
        return any([masked(item) for item in value if isinstance(item, inner)])
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.is_masked(value))


def doubt_angles(what: str, angles: Mapping[str, float]) -> None:
    """Warn that large angles may have been meant in degrees.

    It warns at most once for each `what` and joint, even in a loop, and not again for the same value of a joint under another
    `what`.

    Args:
        what: What the angles are, for the message.
        angles: The angles [rad] by joint; '' stands for no joint.
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
    """Warn that a length `away` [m] may have been meant in millimetres, if it is beyond FAR_AWAY times the arm's `reach` [m].

    It warns only once for each `what`: what the length is, for the message.
    """
    if away > FAR_AWAY * reach and what not in DOUBTED:
        DOUBTED.add(what)
        logging.getLogger("ik_toolkit").warning(
            "%s: %.4g m is %.3g times the robot's reach; were millimetres meant?", what, away, away / reach
        )


def extras() -> dict[str, list[str]]:
    """Return, for each extra of ik_toolkit (an optional set of dependencies), the packages it needs; {} if not installed."""
    import importlib.metadata  # imported here so that `import ik_toolkit` stays fast

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
    """Return the option most similar to a misspelled name, None if the similarity (0 to 1, see `difflib`) is below `alike`."""
    known = [str(option)[:SHOWN] for option, _ in zip(options, range(COMPARED), strict=False)]
    lower = [option.lower() for option in known]
    best = difflib.get_close_matches(str(name)[:SHOWN].lower(), lower, 1, alike)
    return known[lower.index(best[0])] if best else None


def near_match(name: object, options: Iterable[str]) -> str:
    """Return ' Did you mean ...? Available: ...' for an unknown name, to be appended to an error message."""
    known = [str(option)[:SHOWN] for option in options]
    close = nearest(name, known)
    listed = ", ".join(known[:30]) + (f", ... ({len(known)} in all)" if len(known) > 30 else "")
    return (f" Did you mean '{close}'?" if close else "") + (f" Available: {listed}." if known else "")
