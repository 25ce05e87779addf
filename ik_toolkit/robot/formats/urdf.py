"""Safe reading of a URDF: one capped streaming parse that expands no entities and fetches nothing."""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, NoReturn
from xml.parsers import expat

from ...errors import ModelError
from .decode import decode, undeclared

MAX_BYTES = 20_000_000
MAX_JOINTS = 1_000  # including fixed and mimic joints: Pinocchio's parser recurses once per joint of a chain
MAX_FREEDOM = 128  # one pin.Data holds eight arrays of n^3 doubles: 134 MB at 128, 0.5 GB at 200, 8 GB at 500
MAX_ELEMENTS = 200_000
MAX_DEPTH = 64
MAX_ATTRIBUTES = 64  # of one element; Pinocchio's parser takes quadratic time, and URDF defines at most 6
MAX_NAME = 255  # characters, as for a file name; messages repeat names
MAX_TAG = 1_000_000  # bytes of one tag or comment, which the parser keeps in memory whole
CHUNK = 65_536
BLANK = "\ufeff \t\r\n"  # characters that may precede XML
ENDLESS = 1e16  # a limit that Robot reads as "no limit" (NO_LIMIT)
FREEDOM = {
    "revolute": 1,
    "continuous": 1,
    "prismatic": 1,
    "planar": 3,
    "floating": 6,
}  # degrees of freedom by joint type
NUMBERS = {  # element -> attribute -> count of numbers
    "origin": {"xyz": 3, "rpy": 3, "quat_xyzw": 4},
    "axis": {"xyz": 3},
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
}
ITEMS = ("link", "joint", "material")
# Elements that make a description xacro. A call of a macro alone cannot be expanded: a plain URDF from which it was left over.
XACRO = ("include", "macro", "property", "arg", "if", "unless", "insert_block", "call", "element", "attribute")
XACRO_TAGS = frozenset(f"xacro:{word}" for word in XACRO)
SHAPES = ("visual", "collision")
NAMED = {"robot", "link", "joint", "parent", "child", "mimic"}  # elements whose attributes are names


class Part(NamedTuple):
    """An element below a link, joint or material: its tag, attributes and line, and the tags between the two, outermost first."""

    tag: str
    attributes: Mapping[str, str]
    line: int
    above: tuple[str, ...] = ()


@dataclass
class Item:
    """The robot or an element directly below it: its attributes and line, and the elements inside a link, joint or material.

    shapes: for each visual and collision of a link 'role' (its tag), 'name', 'geometry' (tag, attributes), and the attributes of
    'origin' (its rotation as rpy), 'material' and 'color', where they are given.
    """

    tag: str
    attributes: Mapping[str, str]
    line: int
    inside: list[Part] = field(default_factory=list)
    shapes: list[dict[str, Any]] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Its name, or ''."""
        return self.attributes.get("name", "")

    def __str__(self) -> str:
        """Kind and name, for messages."""
        return f"{self.tag} '{self.name}'" if self.name else f"{self.tag} in line {self.line}"

    def own(self, tag: str) -> list[Part]:
        """Return the elements with this tag that are not inside another one."""
        return [part for part in self.inside if part.tag == tag and not part.above]

    def first(self, tag: str) -> Mapping[str, str] | None:
        """Attributes of the first such element, or None: the one that counts, as in urdfdom."""
        return next((part.attributes for part in self.inside if part.tag == tag and not part.above), None)


class HasMacros(ModelError):
    """A description that xacro has to expand first."""


class IsMjcf(ModelError):
    """A description that MuJoCo has to compile first."""


def is_text(source: object) -> bool:
    """Whether a source is XML text rather than a path or a name."""
    return isinstance(source, str) and source.lstrip(BLANK).startswith("<")


def safe_read(source: str | Path) -> str:
    """URDF text from a file or a string, after a parse that expands and fetches nothing.

    Raises ModelError, in one sentence, if it is missing, empty, over 20 MB, not UTF-8, malformed (with the line), xacro, has a
    DOCTYPE or entities, is nested too deep, has too many elements, over 1,000 joints or 128 degrees of freedom, too long a
    name or tag, or no root <robot>.
    """
    text = source_text(source, "URDF")
    parse(text)
    return text


def source_text(source: str | Path, what: str) -> str:
    """Text from a file or a string; ModelError if it is missing, empty, over 20 MB or not UTF-8."""
    if is_text(source):
        assert isinstance(source, str)
        if len(source) > MAX_BYTES:
            raise ModelError(f"the {what} text is larger than {MAX_BYTES // 1_000_000} MB")
        return undeclared(source.lstrip(BLANK))
    return _read_file(Path(source).expanduser())


def _read_file(path: Path) -> str:
    shown, raw = repr(str(path)[:200]), b""
    try:
        regular, exists = path.is_file(), path.exists()
        if regular:
            with path.open("rb") as file:
                raw = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise ModelError(f"cannot read {shown}: {getattr(error, 'strerror', None) or error}") from None
    if not regular:
        raise ModelError(f"{shown} is not a regular file" if exists else f"there is no file {shown}")
    if len(raw) > MAX_BYTES:
        raise ModelError(f"'{path.name}' is larger than {MAX_BYTES // 1_000_000} MB, too large for a robot description")
    text = decode(raw, path.name).lstrip(BLANK)
    if not text:
        raise ModelError(f"'{path.name}' is empty")
    if not text.isascii() and len(text.encode(errors="replace")) > MAX_BYTES:
        raise ModelError(f"'{path.name}' is larger than {MAX_BYTES // 1_000_000} MB as UTF-8")
    return text


@functools.lru_cache(maxsize=4)
def parse(text: str) -> list[Item]:
    """The robot, its links, joints and materials in the order of a URDF text; ModelError if it is not one or exceeds a cap."""
    items: list[Item] = []
    joints = 0
    macros = "${" in text or "$(" in text

    def start(tag: str, attributes: dict[str, str], above: Sequence[str], line: int) -> None:
        nonlocal joints
        if tag in NAMED:
            check_names(attributes, "URDF", line)
        if not above and tag == "mujoco":
            raise IsMjcf("this is MJCF, not a URDF")
        if not above and tag == "mujocoinclude":
            raise ModelError("this is a part of an MJCF model; load the file that includes it")
        if not above and tag != "robot":
            raise ModelError(f"the root element is <{tag}>, not <robot>: this is not a URDF")
        if tag in XACRO_TAGS or (macros and any("${" in x or "$(" in x for x in attributes.values())):
            raise HasMacros(f"line {line} has xacro macros; expand it first: xacro IN.xacro > OUT.urdf")
        if len(above) < 2:
            joints += tag == "joint" and len(above) == 1
            if joints > MAX_JOINTS:
                raise ModelError(f"the URDF has more than {MAX_JOINTS:,} joints; it is not read")
            items.append(Item(tag, attributes, line))
        elif above[1] in ITEMS:
            items[-1].inside.append(Part(tag, attributes, line, tuple(above[2:])))
            if above[1] == "link" and (len(above) > 2 or tag in SHAPES):
                _shape(items[-1].shapes, above[2:], tag, attributes)

    walk(text, "URDF", start)
    joined = [item for item in items if item.tag == "joint" and item.first("mimic") is None]
    freedom = sum(FREEDOM.get(item.attributes.get("type", ""), 0) for item in joined)
    if freedom > MAX_FREEDOM:
        raise ModelError(
            f"the URDF has {freedom} degrees of freedom; at most {MAX_FREEDOM} are read, because the memory Pinocchio "
            "needs grows with their cube; make the joints that need not move fixed"
        )
    return items


def check_names(attributes: Mapping[str, str], what: str, line: int) -> None:
    """Raise ModelError if an attribute that is a name is too long."""
    if any(len(value) > MAX_NAME for value in attributes.values()):
        raise ModelError(f"the {what} has a name of more than {MAX_NAME} characters in line {line}; it is not read")


def walk(text: str, what: str, start: Callable[[str, dict[str, str], Sequence[str], int], None]) -> None:
    """Parse XML text with size caps and call `start` with each element's tag, attributes, ancestors' tags and line.

    what: the kind of file ('URDF'), for messages. Raises ModelError: not well-formed, has a DOCTYPE or entities, is nested too
    deep, has too many elements or attributes, or too long a tag.
    """
    stack: list[str] = []
    elements = 0
    parser = expat.ParserCreate("utf-8")  # the encoding used below, whatever the XML declaration says

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal elements
        elements += 1
        if elements > MAX_ELEMENTS:
            raise ModelError(f"the {what} has more than {MAX_ELEMENTS:,} elements; it is not read")
        line = parser.CurrentLineNumber
        if len(stack) >= MAX_DEPTH:
            raise ModelError(f"the {what} is nested more than {MAX_DEPTH} deep in line {line}; it is not read")
        if len(attributes) > MAX_ATTRIBUTES:
            raise ModelError(
                f"the {what} has an element with {len(attributes):,} attributes in line {line}; it is not read"
            )
        start(tag, attributes, stack, line)
        stack.append(tag)

    def end(tag: str) -> None:
        stack.pop()

    def refuse(*_: object) -> NoReturn:
        raise ModelError(
            f"the {what} has a DOCTYPE or entity declarations; these are rejected, never expanded or fetched"
        )

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.ExternalEntityRefHandler = refuse
    try:
        _feed(parser, text.encode(), what)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code) or "syntax error"
        raise ModelError(f"the {what} is not well-formed XML: {reason} in line {error.lineno}") from None
    except UnicodeEncodeError:
        raise ModelError(f"the {what} text has characters that UTF-8 cannot hold (lone surrogates)") from None


def _shape(shapes: list[dict[str, Any]], above: Sequence[str], tag: str, attributes: Mapping[str, str]) -> None:
    """Record an element of a link below `above`; where only one is allowed the first counts, as in Pinocchio's parser."""
    if not above:
        shapes.append({"role": tag, "name": attributes.get("name", "")})
    elif above[0] in SHAPES:
        if (len(above) == 1 and tag in ("origin", "material")) or (above[1:] == ["material"] and tag == "color"):
            shapes[-1].setdefault(tag, plain_origin(attributes) if tag == "origin" else attributes)
        elif above[1:] == ["geometry"]:
            shapes[-1].setdefault("geometry", (tag, attributes))


def numbers(text: str) -> list[float] | None:
    """Read the numbers of an attribute; None if anything else is in it."""
    try:
        return [float(word) for word in text.split()] if "_" not in text else None
    except ValueError:
        return None


def plain_origin(origin: Mapping[str, str]) -> Mapping[str, str]:
    """Attributes of an <origin> with its quaternion as rpy; unchanged if it has none, has both, or it is no rotation."""
    quaternion = numbers(origin.get("quat_xyzw", "")) or []
    if "rpy" in origin or len(quaternion) != 4 or not 1e-6 < math.hypot(*quaternion) < math.inf:
        return origin
    unit = [x / math.hypot(*quaternion) for x in quaternion]
    from ..rotation import matrix_rpy, quat_matrix

    rpy = " ".join(map(repr, matrix_rpy(quat_matrix(unit)).tolist()))
    return {key: value for key, value in origin.items() if key != "quat_xyzw"} | {"rpy": rpy}


def span(joint: Item) -> tuple[float, float]:
    """Lower and upper limit [rad or m] of a joint: 0 where its <limit> has none, as URDF says, and ENDLESS at most, either way.

    A follower whose <limit> is missing, or has neither, is held by its leader's limits alone.
    """
    limit = joint.first("limit") or {}
    led = joint.first("mimic") is not None and not limit.keys() & {"lower", "upper"}
    if led or joint.attributes.get("type") == "continuous":
        return -ENDLESS, ENDLESS
    low, high = (min(max(float(limit.get(end, "0")), -ENDLESS), ENDLESS) for end in ("lower", "upper"))
    return low, high


def _feed(parser: Any, raw: bytes, what: str) -> None:
    """Parse piece by piece, so that an endless tag or comment is rejected before it fills the memory."""
    for start in range(0, len(raw), CHUNK):
        parser.Parse(raw[start : start + CHUNK], False)
        if start + CHUNK - parser.CurrentByteIndex > MAX_TAG + CHUNK:
            raise ModelError(
                f"the {what} has a tag or comment of more than {MAX_TAG // 1_000_000} MB in line "
                f"{parser.CurrentLineNumber}; it is not read"
            )
    parser.Parse(b"", True)
