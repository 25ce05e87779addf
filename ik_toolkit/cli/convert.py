"""`ik convert`: any description of a robot as one plain URDF."""

from pathlib import Path

import typer

from ..errors import CONTROLS
from ..files import write_whole
from .arguments import Json, PackageDir, RobotArg, UrdfOut, XacroArg, assignments
from .output import notice, write_json

SHOWN = 3  # meshes that are not found and named


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(convert)


def convert(
    robot: RobotArg,
    output: UrdfOut = None,
    package_dir: PackageDir = None,
    xacro_arg: XacroArg = None,
    as_json: Json = False,
) -> None:
    """Write a robot as one plain URDF: xacro expanded, package:// names of meshes resolved.

    Meshes below the folder of the new file are named relative to it, all others by their absolute path.
    """
    from ..robot.formats.convert import convert as make

    made = make(
        robot,
        None if output is None else output.parent,
        package_dirs=package_dir or (),
        xacro_args=assignments(xacro_arg, "--xacro-arg", ":=") or None,
    )
    if output is not None:
        write_whole(output, made.text)
        notice(f"wrote {output}: {made.name}, {len(made.meshes)} mesh files")
    if made.lost:
        some = "; ".join(f"'{name}' {why}" for name, why in list(made.lost.items())[:SHOWN])
        more = f"; and {len(made.lost) - SHOWN} more" if len(made.lost) > SHOWN else ""
        notice(f"meshes that keep their names (--package-dir names their folder): {some}{more}")
    outside = sorted({str(Path(file).parent) for file in made.meshes.values() if Path(file).is_absolute()})
    if outside and output is not None:
        notice(f"meshes lie outside its folder; pictures and collisions of it need --package-dir {outside[0]}")
    if as_json:
        rows = {"name": made.name, "output": output, "meshes": made.meshes, "lost": made.lost, "urdf": made.text}
        write_json(rows, True)
    elif output is None:
        print(CONTROLS.sub(lambda found: f"&#{ord(found[0])};", made.text), end="")  # the same XML, for a terminal
