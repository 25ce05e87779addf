"""The path of `ik track`: as the options give it, or one that every robot can follow; and what to try if it cannot."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

from ..errors import InvalidOption, near_match, whole
from ..text import vector
from .output import notice, number

if TYPE_CHECKING:
    from ..motion.reference import Reference
    from ..servo.path_reach import References, Survey

SHAPES = ("circle", "line", "eight")
RADIUS, LENGTH, DURATION = 0.1, 0.2, 10.0  # [m, s] where a path is given in part
PLACE = {  # options that say where a path is and how large; a file says all that itself
    "circle": ("radius", "axis", "start"),
    "eight": ("radius", "axis", "start"),
    "line": ("length", "axis", "start", "end"),
    "file": (),
}
FAR = 20.0  # times the reach: a path that goes further away is more often in millimetres
SEEN = 65  # points of a path that are looked at for that
TIMES = ("duration", "law", "turns")
AXES = ("1 0 0", "0 1 0", "0 0 1", "-1 0 0", "0 -1 0", "0 0 -1")


class Asked(NamedTuple):
    """A path to follow: its reference, where the joints start (None: solved for), and how it was chosen, in words or ''."""

    reference: "References"
    q0: Any
    words: str

    @property
    def shown(self) -> str:
        """The reference in a line, or a line per tip."""
        if isinstance(self.reference, Mapping):
            return "; ".join(f"{tip}: {_line(one)}" for tip, one in self.reference.items())
        return _line(self.reference)


def _line(reference: "Reference") -> str:
    """A reference in a line."""
    return f"{reference.name} in {reference.duration:g} s{', orientation free' if reference.position_only else ''}"


def asked_path(arm: Any, line: SimpleNamespace, q: Any, counts: dict[str, Any]) -> Asked:
    """Path of the options; `q` (n,) is --q0 or None, `counts` what counts of the targets. Raises InvalidOption."""
    from ..motion.waypoints import reference_from_file
    from ..servo.path_reach import freed

    if line.path is None and any(_given(line, name) for name in (*PLACE["line"], *PLACE["circle"], "law", "turns")):
        line.path = "circle"
    _check_fit(line)
    if line.path is None and not counts.get("relative_to"):
        from ..servo.default_path import joint_motion

        motion = joint_motion(
            arm, q, position_only=line.position_only, duration=line.duration, dt=1.0 / line.rate,
            position_tolerance=line.position_tolerance,
        )  # fmt: skip
        seconds = next(iter(motion.values())).duration if isinstance(motion, Mapping) else motion.duration
        start = "home" if q is None else "--q0"
        return Asked(motion, arm.home if q is None else q, f"all joints swing a little from {start}, and back, in {seconds:g} s")
    if line.path is not None and line.path not in SHAPES:
        if Path(line.path).suffix.lower() not in (".csv", ".npz"):
            raise InvalidOption(f"no path '{line.path}'.{near_match(line.path, SHAPES)} Or give a .csv or .npz file.")
        reference = reference_from_file(line.path)
        return Asked(freed(reference) if line.position_only and not reference.position_only else reference, q, "")
    line.path = line.path or "circle"
    return Asked(_drawn(arm, line, q, counts), arm.home if q is None and line.start is None else q, "")


def doubt_metres(arm: Any, reference: "References") -> None:
    """Warn, once, that a path far beyond the reach may have been meant in millimetres."""
    import numpy as np

    at = arm.fk(arm.home)
    tips = at if arm.by_tip else {arm.tip: at}
    each = reference if isinstance(reference, Mapping) else {arm.tip: reference}
    for tip, one in each.items():
        way = one.at(np.linspace(0.0, one.duration, SEEN))[0][:, :3, 3] - tips[tip].translation
        away = float(np.linalg.norm(way, axis=1).max())
        if away > FAR * arm.reach:
            times = f"{away / arm.reach:.3g} times its reach" if arm.reach > 0.0 else "which cannot move"
            notice(f"warning: the path goes {away:.4g} m away from {tip} at home, {times}; were millimetres meant?")
            return


def _check_fit(line: SimpleNamespace) -> None:
    """Refuse options that the path does not have, rather than pass over them. Raises InvalidOption."""
    if line.path is None:
        return
    kind = line.path if line.path in SHAPES else "file"
    names = ("radius", "length", "axis", "start", "end", "duration", "law", "turns")
    given = [name for name in names if _given(line, name)]
    fit = PLACE[kind] + (TIMES if kind != "file" else ())
    if line.end is not None and kind == "line":
        fit = tuple(name for name in fit if name not in ("length", "axis"))
    odd = [f"--{name}" for name in given if name not in fit]
    if odd:
        what = (
            "a path from a file"
            if kind == "file"
            else f"--path {kind}{' with --end' if line.end and kind == 'line' else ''}"
        )
        takes = f"; it takes {', '.join(f'--{name}' for name in fit)}" if fit else ", which says all of it"
        raise InvalidOption(f"{', '.join(odd)} cannot be used with {what}{takes}")
    if line.turns_ == 0.0 and kind != "line":
        raise InvalidOption(f"--turns must not be 0 with --path {kind}; only a line has none, which is one way")


def _given(line: SimpleNamespace, name: str) -> bool:
    """Whether an option is given."""
    return getattr(line, "turns_" if name == "turns" else name) is not None


def _axis(line: SimpleNamespace) -> Any:
    if line.axis is None:
        return None
    axis = vector(line.axis, "--axis", 3)
    if not any(axis):
        raise InvalidOption("--axis must not be zero")
    return axis


def _drawn(arm: Any, line: SimpleNamespace, q: Any, counts: dict[str, Any]) -> "References":
    """The path as it is given: from the tip at --q0 or home, or from --start, with the tip's orientation."""
    from ..servo.default_path import paths

    if line.start is not None or (line.path == "line" and line.end is not None):
        if arm.by_tip:
            raise InvalidOption("--start and --end are for one tip; choose it with --tip")
        return _from_to(arm.fk(arm.home if q is None else q).homogeneous, line)
    relative = counts.get("relative_to") or {}
    start = arm.home if q is None else q
    return paths(arm, start, line.path, _size(line), _axis(line), line.position_only, relative, **_rest(line))


def _size(line: SimpleNamespace) -> float:
    """Length of the line, or radius, as asked or by default [m]."""
    given, usual = (line.length, LENGTH) if line.path == "line" else (line.radius, RADIUS)
    return usual if given is None else given


def _rest(line: SimpleNamespace) -> dict[str, Any]:
    return {
        "duration": DURATION if line.duration is None else line.duration,
        "law": line.law,
        "turns": line.turns_ or 0.0,
    }


def _from_to(T: Any, line: SimpleNamespace) -> "Reference":
    """The path from --start, or to --end, of a tip that stands at T."""
    import numpy as np

    from ..motion import shapes
    from ..servo.default_path import draw

    if line.start is not None:
        T[:3, 3] = vector(line.start, "--start", 3)
    at: Any = T[:3, 3].copy() if line.position_only else T
    if line.path != "line" or line.end is None:
        return draw(line.path, at, _size(line), _axis(line), **_rest(line))
    end = np.array(vector(line.end, "--end", 3))
    T1 = T.copy()
    T1[:3, 3] = end
    seconds, law = _rest(line)["duration"], line.law or "minimum-jerk"
    return shapes.line(
        at,
        end if line.position_only else T1,
        duration=seconds,
        law=law,
        rounds=whole(line.turns_ or 0.0, "rounds of a line", 0),
    )


def advice(
    arm: Any, line: SimpleNamespace, asked: Asked, q: Any, found: "Survey", follows: Callable[..., bool], **options: Any
) -> list[str]:
    """Options with which the robot follows a path given in part or in a file, each found by trying it.

    follows(reference, q0): whether a run with the other options of the command succeeds.
    """
    from ..servo.path_reach import other_start, trace

    def drawn(more: dict[str, Any]) -> Any:
        return _drawn(arm, SimpleNamespace(**{**vars(line), **more}), q, options)

    if found.whole:
        share, seconds = found.pace[0], line.duration or DURATION
        slower = float(f"{1.1 * share * seconds:.2g}")
        fits = share > 1.0 and line.path in SHAPES and follows(drawn({"duration": slower}), asked.q0)
        return [f"--duration {slower:g}"] if fits else []
    one: dict[str, str] = {}  # the largest of several sizes, the first of several axes
    for words, more in _ways(line, found):
        name = words.split()[0]
        if name in one:
            continue
        path = drawn(more)
        if trace(arm, path, asked.q0, **options) is not None and follows(path, asked.q0):
            one[name] = words
    elsewhere = other_start(arm, asked.reference, **options)
    if elsewhere is not None and follows(asked.reference, elsewhere):
        shown = (number(float(x), kind, line.deg) for x, kind in zip(elsewhere, arm.joint_kinds, strict=True))
        one["--q0"] = f"--q0 {' '.join(shown)}"
    return [*one.values()]


def _ways(line: SimpleNamespace, found: "Survey") -> Iterator[tuple[str, dict[str, Any]]]:
    """Other options to try: as words, and as changes of the command line."""
    from ..servo.path_reach import smaller

    if line.path not in SHAPES:
        return
    if not line.position_only:
        yield "--position-only", {"position_only": True}
    name = "length" if line.path == "line" else "radius"
    size = _size(line)
    if line.end is None:
        for factor in smaller(found):
            shorter = float(f"{factor * size:.3g}")
            yield f"--{name} {shorter:g}", {name: shorter}
        for axis in AXES:
            yield f"--axis {axis}", {"axis": axis}
