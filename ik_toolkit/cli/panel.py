"""`ik panel`: move a robot by hand in a browser."""

from typing import Annotated

import typer

from ..errors import InvalidOption
from .arguments import RobotArg, Tips
from .output import notice

Host = Annotated[str, typer.Option(metavar="ADDRESS", help="Address to listen on; default: this machine only.")]
Port = Annotated[int, typer.Option(metavar="N", help="Port; default: a free one.")]
Open = Annotated[bool, typer.Option("--open/--no-open", help="Open the address in a browser.")]


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(panel)


def panel(
    robot: RobotArg = "hydrolek_7w", tip: Tips = None, host: Host = "127.0.0.1", port: Port = 0, browse: Open = True
) -> None:
    """Move joints, drag targets, compare solvers and solutions in a browser, until Ctrl-C.

    Listens on this machine only unless --host says otherwise. The printed address contains an access token: nobody without it
    is let in. Every browser tab has its own robot. A robot with several tips has a target to drag for each.
    """
    if not 0 <= port < 65536:
        raise InvalidOption(f"--port must be between 0 and 65535, not {port}")

    from ..show.access import is_loopback
    from ..show.panel.panel import Panel
    from .pictures import wait

    served = Panel(robot, tip, host=host, port=port)
    if not is_loopback(host):
        notice(
            f"warning: the panel listens at {host}, unencrypted: anyone who knows the address below can use it,"
            " and anyone who can read the network traffic learns it"
        )
    wait(f"the panel is at {served.url}", served.url, browse)
    served.close()
