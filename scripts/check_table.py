"""Run `ik check` on every description in folders and write what it reports as a page of the guide.

Usage: python scripts/check_table.py NAME=FOLDER... [-o docs/guide/checked_robots.md]. The page of the guide is of
example-robot-data 6 and of rtb-data 2 (pip download --no-deps rtb-data, unpacked).
"""

import argparse
import logging
import re
import sys
from collections.abc import Iterable
from pathlib import Path

from ik_toolkit.cli.files import every_finding
from ik_toolkit.errors import IKError
from ik_toolkit.files import write_whole
from ik_toolkit.robot.formats.finding import Finding, error_finding
from ik_toolkit.robot.library import find

PART = "contains xacro macros but no robot"  # a file that others include
PAGE = """# What `ik check` reports of public robots

Every URDF and xacro file of {names}, checked with

```
{command}
```

{total} descriptions were checked: {clean} without a finding, {warned} with warnings, {failed} that cannot be loaded; {parts} more
files are parts that others include. Those with findings are listed with an example of each kind and its line ("3 x": there are
three of the kind). An entry in **bold** is also said when the robot is loaded.

| file | findings |
| --- | --- |
{rows}
"""


def main(arguments: list[str]) -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("where", nargs="+", metavar="NAME=FOLDER")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/guide/checked_robots.md"))
    given = parser.parse_args(arguments)
    logging.getLogger("ik_toolkit").setLevel(logging.CRITICAL)
    rows, counts, names = [], dict.fromkeys(("total", "clean", "warned", "failed", "parts"), 0), []
    for where in given.where:
        name, _, folder = where.partition("=")
        names.append(name)
        root = Path(folder).resolve()
        files = sorted(path for kind in ("*.urdf", "*.xacro") for path in root.rglob(kind))
        packages = sorted({path.parent.parent for path in root.rglob("urdf") if path.is_dir()} | {root})
        for file in files:
            found = check(file, packages)
            if found and PART in found[0].problem:
                counts["parts"] += 1
                continue
            failed = any(finding.severity == "error" for finding in found)
            counts["total"] += 1
            counts["failed" if failed else "warned" if found else "clean"] += 1
            if found:
                shown = file.relative_to(root).as_posix()
                rows.append(f"| {name}: {shown} | {'<br>'.join(kinds(found, root))} |")
    command = "python scripts/check_table.py " + " ".join(f"{name}=FOLDER" for name in names)
    write_whole(given.output, PAGE.format(names=" and ".join(names), command=command, rows="\n".join(rows), **counts))
    print(f"wrote {given.output}: {counts}")


def check(file: Path, packages: Iterable[Path]) -> list[Finding]:
    """Findings for a file, as `ik check` gives them."""
    try:
        return every_finding(str(file), find(file), {"package_dirs": packages})[0]
    except IKError as error:  # such as a missing extra
        return [error_finding("file", str(error), "", 0)]


def kinds(found: list[Finding], root: Path) -> list[str]:
    """One example of each kind of finding: those of a kind give the same advice."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in found:
        groups.setdefault((finding.severity, finding.advice.partition(".")[0]), []).append(finding)
    out = []
    for (severity, _), group in groups.items():
        first = group[0]
        text = re.sub(r"([<>|])", r"\\\1", str(first).replace(f"{root}/", ""))
        count = f"{len(group)} x " if len(group) > 1 else ""
        line = f" (line {first.line})" if first.line else ""
        told = f"{'error: ' if severity == 'error' else ''}{count}{text}{line}"
        out.append(f"**{told}**" if first.at_load else told)
    return out


if __name__ == "__main__":
    main(sys.argv[1:])
