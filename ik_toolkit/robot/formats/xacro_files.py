"""Reads the files that a xacro file includes or loads, only below the allowed folders and no larger than a robot needs."""

import os
from collections.abc import Callable
from typing import Any, NamedTuple
from xml.dom import minidom

from .urdf import decode, walk
from .xacro_values import DEEP, Refused

UNITS = {"radians": 1.0, "degrees": "pi/180", "meters": 1.0, "millimeters": 0.001, "foot": 0.3048, "inches": 0.0254}


class XacroFileCaps(NamedTuple):
    """Limits on the files that xacro reads, so that none exhausts this process; a file that exceeds one is refused."""

    bytes: int = 20_000_000  # Limit on the bytes of all files together.
    yaml_bytes: int = 2_000_000  # Limit on the bytes of a YAML file, before and after its anchors are expanded.
    yaml_scalar: int = 2_000  # Limit on the characters of one value in YAML.


CAPS = XacroFileCaps()


class Files:
    """Reads files that lie, with symbolic links resolved, below allowed folders, and counts the bytes read in all."""

    def __init__(self, folders: list[str]) -> None:
        """Store the allowed folders."""
        self.folders = [os.path.realpath(folder) for folder in folders]
        self.bytes = 0

    def read(self, path: str, most: int) -> bytes:
        """Return the contents of a file of at most `most` bytes.

        Raises Refused if it is not allowed or too large, FileNotFoundError if it is allowed but does not exist.
        """
        path = os.path.abspath(path)
        real = os.path.realpath(path)
        if not any(real.startswith(os.path.join(folder, "")) for folder in self.folders):
            link = "" if real == path else f" (it leads to '{real[-120:]}')"
            raise Refused(
                f"it reads '{path[-120:]}', which is not allowed{link}; if it may, name its folder: "
                f"package_dirs=['{os.path.dirname(real)[-100:]}'], in the shell --package-dir"
            )
        if os.path.exists(real) and not os.path.isfile(real):
            raise Refused(f"'{path[-120:]}' is not a regular file")
        with open(real, "rb") as file:
            raw = file.read(most + 1)
        self.bytes += len(raw)
        if len(raw) > most or self.bytes > CAPS.bytes:
            raise Refused(f"'{os.path.basename(path)[:100]}' and what is read before it are too large")
        return raw

    def xml(self, path: str) -> Any:
        """Return an XML file parsed by xml.dom.minidom. Raises Refused if it is not allowed or too large, ModelError."""
        text = decode(self.read(path, CAPS.bytes), os.path.basename(path))
        walk(text, "file", lambda *element: None)  # This parse raises an error if the text exceeds a limit.
        return minidom.parseString(text)  # noqa: S318 - The text was checked above.

    def yaml(self, path: str, number: Callable[[str], float]) -> Any:
        """Return the contents of a YAML file; `number` evaluates a value with a unit, such as !degrees 90. Raises Refused."""
        import yaml

        raw = self.read(path, CAPS.yaml_bytes)

        Loader: Any = type("Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})

        for unit, factor in UNITS.items():
            Loader.add_constructor(f"!{unit}", lambda _, node, times=factor: number(f"({node.value})*{times}"))
        # Dates (such as that of a calibration) and binary data are kept as text, because expressions may not hold such objects.
        for plain in ("timestamp", "binary"):
            Loader.add_constructor(f"tag:yaml.org,2002:{plain}", lambda _, node: str(node.value))
        try:
            check_yaml_size(yaml.parse(raw, Loader))
            return yaml.load(raw, Loader)  # noqa: S506 - The loader is a safe one.
        except (yaml.YAMLError, ValueError) as error:
            said = " ".join(str(error).split())[:160]
            raise Refused(f"'{os.path.basename(path)[:60]}' cannot be read as YAML: {said}") from None


def check_yaml_size(events: Any) -> None:
    """Raise Refused if the YAML parse `events` show that it is nested too deep, or too large once its anchors are expanded."""
    known: dict[str, int] = {}
    open_: list[tuple[str | None, int]] = [(None, 0)]
    for event in events:
        kind, anchor, weight = type(event).__name__, getattr(event, "anchor", None), 1
        if kind in ("MappingStartEvent", "SequenceStartEvent"):
            open_.append((anchor, 1))
            if len(open_) > DEEP:
                raise Refused(f"YAML is nested more than {DEEP} deep")
            continue
        if kind in ("MappingEndEvent", "SequenceEndEvent"):
            anchor, weight = open_.pop()
        elif kind == "ScalarEvent":
            weight += len(event.value)
            if weight > CAPS.yaml_scalar:
                raise Refused(f"a value in YAML has more than {CAPS.yaml_scalar:,} characters")
        elif kind == "AliasEvent":
            weight = known.get(anchor or "", 1)
            anchor = None
        else:
            continue
        if anchor:
            known[anchor] = weight
        above, before = open_[-1]
        open_[-1] = above, before + weight
        if before + weight > CAPS.yaml_bytes:
            raise Refused("YAML is too large once its anchors are put in")
