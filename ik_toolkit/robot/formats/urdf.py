"""Reads a URDF safely, in one streaming parse with size limits that expands no entities and fetches nothing."""

import codecs
import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, NoReturn
from xml.parsers import expat

from ...errors import ModelError
from ...files import from_home, why_unread
from ...text import decimal


class UrdfCaps(NamedTuple):
    """Limits on the size of a URDF, so that no file can exhaust this process; a file that exceeds one of them is refused."""

    bytes: int = 20_000_000
    # Limit on all joints, also fixed and mimic ones, because Pinocchio's parser recurses once per joint of a chain.
    joints: int = 1_000
    # A pin.Data holds eight arrays of n^3 doubles: 134 MB at 128 degrees of freedom, 0.5 GB at 200, 8 GB at 500.
    freedom: int = 128
    elements: int = 200_000
    depth: int = 64
    attributes: int = 64  # Pinocchio's parser takes time quadratic in the attributes of an element; URDF has at most 6.
    name: int = 255  # A name may have as many characters as a file name, because messages repeat names.
    # A tag or comment with more bytes is refused, because the parser keeps it in memory as a whole.
    tag: int = 1_000_000
    chunk: int = 65_536  # Number of bytes that are given to the parser at a time.


CAPS = UrdfCaps()
BLANK = "\ufeff \t\r\n"  # Characters that may precede the first < of XML: the byte order mark, and blanks.
ENDLESS = 1e16  # A limit of position, velocity or effort of this size means "no limit".
# The number of degrees of freedom of each joint type of URDF.
FREEDOM = {"revolute": 1, "continuous": 1, "prismatic": 1, "planar": 3, "floating": 6}
SIZES = {  # For each shape, its attributes with sizes, and how many numbers each of them holds.
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
}
NUMBERS = {  # For each element, its attributes with numbers, and how many numbers each of them holds.
    "origin": {"xyz": 3, "rpy": 3, "quat_xyzw": 4},
    "axis": {"xyz": 3},
    "mimic": {"multiplier": 1, "offset": 1},
    **SIZES,
    "mesh": {"scale": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
}
ITEMS = ("link", "joint", "material")
# A description with one of these elements must be expanded by xacro.
# A call of a macro alone does not count, because plain URDFs contain leftover calls that cannot be expanded.
XACRO = ("include", "macro", "property", "arg", "if", "unless", "insert_block", "call", "element", "attribute")
XACRO_TAGS = frozenset(f"xacro:{word}" for word in XACRO)
SHAPES = ("visual", "collision")
NAMED = {"robot", "link", "joint", "parent", "child", "mimic"}  # Elements of URDF with an attribute that is a name.


class InnerElement(NamedTuple):
    """An element inside a link, joint or material.

    `above` has the tags of the elements between it and the link, joint or material, outermost first.
    """

    tag: str
    attributes: Mapping[str, str]
    line: int
    above: tuple[str, ...] = ()


@dataclass
class Item:
    """The robot, or an element directly below it: a link, joint or material with the elements inside it.

    Each visual and collision of a link has a dict in `shapes`: 'role' (its tag), 'name', 'geometry' (tag, attributes)
    and, where they are given, the attributes of 'origin' (rotation as rpy), 'material' and 'color'.
    """

    tag: str
    attributes: Mapping[str, str]
    line: int
    inside: list[InnerElement] = field(default_factory=list)
    shapes: list[dict[str, Any]] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The attribute `name` of the element, or '' if it has none."""
        return self.attributes.get("name", "")

    def __str__(self) -> str:
        """Return the element's kind and name, for messages."""
        return f"{self.tag} '{self.name}'" if self.name else f"{self.tag} in line {self.line}"

    def own(self, tag: str) -> list[InnerElement]:
        """Return the elements with this tag that are children of this link, joint or material (not deeper)."""
        return [part for part in self.inside if part.tag == tag and not part.above]

    def first(self, tag: str) -> Mapping[str, str] | None:
        """Return the attributes of the first element with this tag, or None; as in urdfdom, later ones do not count."""
        return next((part.attributes for part in self.inside if part.tag == tag and not part.above), None)


class HasMacros(ModelError):
    """Raised for a description with xacro macros, which must be expanded before it can be read as URDF."""


class IsMjcf(ModelError):
    """Raised for a description in MJCF, which MuJoCo must compile before it can be written as URDF."""


def is_text(source: object) -> bool:
    """Return whether a source is XML text rather than a path or a name."""
    return isinstance(source, str) and source.lstrip(BLANK).startswith("<")


def safe_read(source: str | Path) -> str:
    """Return URDF text from a file or a string, after a parse that expands and fetches nothing.

    Raises ModelError, one sentence, if the text is missing, empty, over 20 MB, not UTF-8, malformed (with the line) or xacro, or if
    it has a DOCTYPE or entities, is nested too deep, or has too many elements, over 1,000 joints or 128 degrees of freedom, too
    long a name or tag, or no root <robot>.
    """
    text = source_text(source, "URDF")
    parse(text)
    return text


def source_text(source: str | Path, what: str) -> str:
    """Return text from a file or a string. Raises ModelError if it is missing, empty, over 20 MB or not UTF-8."""
    if is_text(source):
        assert isinstance(source, str)
        if len(source) > CAPS.bytes:
            raise ModelError(f"the {what} text is larger than {CAPS.bytes // 1_000_000} MB")
        return undeclared(source.lstrip(BLANK))
    return _read_file(from_home(source))


def _read_file(path: Path) -> str:
    shown, raw = repr(str(path)[:200]), b""
    try:
        regular, exists = path.is_file(), path.exists()
        if regular:
            with path.open("rb") as file:
                raw = file.read(CAPS.bytes + 1)
    except (OSError, ValueError) as error:  # A path that contains a NUL raises ValueError.
        raise ModelError(f"cannot read {shown}: {why_unread(error)}") from None
    if not regular:
        raise ModelError(f"{shown} is not a regular file" if exists else f"there is no file {shown}")
    if len(raw) > CAPS.bytes:
        raise ModelError(
            f"'{path.name}' is larger than {CAPS.bytes // 1_000_000} MB, too large for a robot description"
        )
    text = decode(raw, path.name).lstrip(BLANK)
    if not text:
        raise ModelError(f"'{path.name}' is empty")
    if not text.isascii() and len(text.encode(errors="replace")) > CAPS.bytes:
        raise ModelError(f"'{path.name}' is larger than {CAPS.bytes // 1_000_000} MB as UTF-8")
    return text


@functools.lru_cache(maxsize=4)
def parse(text: str) -> list[Item]:
    """Parse URDF text into Items: the robot, links, joints and materials, in the order of the text.

    Raises ModelError if it is no URDF or exceeds a limit.
    """
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
            if joints > CAPS.joints:
                raise ModelError(f"the URDF has more than {CAPS.joints:,} joints; it is not read")
            items.append(Item(tag, attributes, line))
        # The <parent> of a joint that stands inside another element is kept, so that an error can name that misplaced joint.
        elif above[1] in ITEMS or (tag == "parent" and above[-1] == "joint" and "link" in attributes):
            items[-1].inside.append(InnerElement(tag, attributes, line, tuple(above[2:])))
            if above[1] == "link" and (len(above) > 2 or tag in SHAPES):
                _shape(items[-1].shapes, above[2:], tag, attributes)

    walk(text, "URDF", start)
    freedoms = [(FREEDOM.get(item.attributes.get("type", ""), 0), item) for item in items if item.tag == "joint"]
    freedom = sum(count for count, item in freedoms if count > 1 or item.first("mimic") is None)
    if freedom > CAPS.freedom:
        raise ModelError(
            f"the URDF has {freedom} degrees of freedom; at most {CAPS.freedom} are read, because the memory Pinocchio "
            "needs grows with their cube; make the joints that need not move fixed"
        )
    return items


def check_names(attributes: Mapping[str, str], what: str, line: int) -> None:
    """Raise ModelError if an attribute that holds a name (of a link, joint or material) is too long."""
    if any(len(value) > CAPS.name for value in attributes.values()):
        raise ModelError(f"the {what} has a name of more than {CAPS.name} characters in line {line}; it is not read")


def walk(text: str, what: str, start: Callable[[str, dict[str, str], Sequence[str], int], None]) -> None:
    """Parse XML text with size limits and call `start` with each element's tag, attributes, ancestors' tags and line.

    `what` is the kind of file ('URDF') for messages. Raises ModelError if the text is malformed, has a DOCTYPE or
    entities, is nested too deep, has too many elements or attributes, or too long a tag.
    """
    stack: list[str] = []
    elements = 0
    parser = expat.ParserCreate("utf-8")  # The text is encoded as UTF-8 below, whatever its XML declaration says.

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal elements
        elements += 1
        if elements > CAPS.elements:
            raise ModelError(f"the {what} has more than {CAPS.elements:,} elements; it is not read")
        line = parser.CurrentLineNumber
        if len(stack) >= CAPS.depth:
            raise ModelError(f"the {what} is nested more than {CAPS.depth} deep in line {line}; it is not read")
        if len(attributes) > CAPS.attributes:
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
    """Record an element inside a link's visual or collision; where URDF allows one, the first counts, as in Pinocchio's parser."""
    if not above:
        shapes.append({"role": tag, "name": attributes.get("name", "")})
    elif above[0] in SHAPES:
        if (len(above) == 1 and tag in ("origin", "material")) or (above[1:] == ["material"] and tag == "color"):
            shapes[-1].setdefault(tag, plain_origin(attributes) if tag == "origin" else attributes)
        elif above[1:] == ["geometry"]:
            shapes[-1].setdefault("geometry", (tag, attributes))


def attribute_numbers(text: str) -> list[float] | None:
    """Return the numbers in an attribute, or None if anything else is in it."""
    try:
        return [decimal(word) for word in text.split()]
    except ValueError:
        return None


def finite_at(attributes: Mapping[str, str] | None, key: str, count: int = 1, default: str = "") -> list[float]:
    """Return the numbers in an attribute if they are this many and all finite, otherwise an empty list."""
    values = attribute_numbers((attributes or {}).get(key, default)) or []
    return values if len(values) == count and all(map(math.isfinite, values)) else []


def plain_origin(origin: Mapping[str, str]) -> Mapping[str, str]:
    """Return the attributes of an <origin> with roll, pitch and yaw (rpy) in place of a quaternion.

    They are unchanged if there is no quaternion, if there is also an rpy, or if the quaternion is not a rotation.
    """
    quaternion = finite_at(origin, "quat_xyzw", 4)
    length = math.hypot(*quaternion)
    if "rpy" in origin or not 1e-6 < length < math.inf:
        return origin
    unit = [x / length for x in quaternion]
    from ..rotation import matrix_rpy, quat_matrix

    rpy = " ".join(map(repr, matrix_rpy(quat_matrix(unit)).tolist()))
    return {key: value for key, value in origin.items() if key != "quat_xyzw"} | {"rpy": rpy}


def limits_of_joint(joint: Item) -> tuple[float, float]:
    """Return the lower and upper limit [rad or m] of a joint: 0 if its <limit> gives none, as in URDF, at most +-1e16 (no limit).

    A mimic joint whose <limit> is missing, or gives neither, is limited only by its leader; its limits are then +-1e16.
    """
    limit = joint.first("limit") or {}
    led = joint.first("mimic") is not None and not limit.keys() & {"lower", "upper"}
    if led or joint.attributes.get("type") == "continuous":
        return -ENDLESS, ENDLESS
    low, high = (min(max(float(limit.get(end, "0")), -ENDLESS), ENDLESS) for end in ("lower", "upper"))
    return low, high


def _feed(parser: Any, raw: bytes, what: str) -> None:
    """Parse the text piece by piece, so that an endless tag or comment is rejected before it fills the memory."""
    for start in range(0, len(raw), CAPS.chunk):
        parser.Parse(raw[start : start + CAPS.chunk], False)
        if start + CAPS.chunk - parser.CurrentByteIndex > CAPS.tag + CAPS.chunk:
            raise ModelError(
                f"the {what} has a tag or comment of more than {CAPS.tag // 1_000_000} MB in line "
                f"{parser.CurrentLineNumber}; it is not read"
            )
    parser.Parse(b"", True)


MARKS = (  # These are byte order marks; UTF-32 is first, because its mark begins with that of UTF-16.
    (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"), (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
    (b"<\0?\0", "utf-16-le"), (b"\0<\0?", "utf-16-be"),
)  # fmt: skip
ALIASES = {"windows-31j": "cp932", "x-sjis": "shift_jis"}  # Encodings that Python knows by another name than XML files.
DECLARED = re.compile(r"""\A(\s*<\?xml[^>]*?)\s+encoding\s*=\s*["']([^"'>]*)["']""")
# Encodings that are accepted: those of text, without Python's codecs that unpack data, such as zip or hex.
TEXTS = re.compile(
    r"utf-8|ascii|iso8859-\d+|cp(125\d|437|85\d|866|932|936|949|950|1361)|koi8-[rtu]|mac-(roman|cyrillic|greek|latin2)|"
    r"shift_jis(_2004|x0213)?|euc_(jp|kr|jis_2004|jisx0213)|iso2022_(jp|kr)(_\w+)?|gb2312|gbk|gb18030|hz|big5(hkscs)?|"
    r"johab|tis-620|ptcp154|kz1048"
)


def decode(raw: bytes, name: str) -> str:
    """Decode the bytes of an XML file and return its text, whose XML declaration then names no encoding.

    `name` is that of the file, for messages. Raises ModelError if the bytes are not text in the encoding found.
    """
    codec = next((codec for mark, codec in MARKS if raw.startswith(mark)), None)
    head = DECLARED.match(raw[:1024].decode("latin-1")) if codec is None else None
    codec = codec or (_codec(head[2]) if head else "utf-8")
    try:
        text = raw.decode(codec)
    except UnicodeDecodeError as error:
        lost = (
            f" and declares '{head[2][:40]}', which is not read" if head and head[2].lower() != codec == "utf-8" else ""
        )
        what = "UTF-8" if codec.startswith("utf-8") else codec
        raise ModelError(f"'{name}' is not {what} text (byte {error.start}){lost}; save it as UTF-8") from None
    if "\0" in text:
        raise ModelError(f"'{name}' is not UTF-8 text (it has NUL bytes); save it as UTF-8")
    return undeclared(text)


def undeclared(text: str) -> str:
    """Remove an encoding other than UTF-8 from an XML declaration, so that no later reader decodes the text again."""
    head = DECLARED.match(text[:1024])
    return text if head is None or head[2].lower() == "utf-8" else head[1] + text[head.end() :]


def _codec(declared: str) -> str:
    """Return Python's codec for a declared encoding, or UTF-8 if the declared one is not in TEXTS.

    UTF-8 may be right even if UTF-16 is declared, because a declaration that could be read is not in UTF-16.
    """
    try:
        codec = codecs.lookup(ALIASES.get(declared.lower(), declared)).name if declared.isascii() else ""
    except (LookupError, ValueError):
        codec = ""
    return codec if TEXTS.fullmatch(codec) else "utf-8"
