"""`ik gains`: whether a tracking method's gains are stable, at rest and along a path."""

from typing import Any

import typer

from ..errors import InvalidOption, InvalidTarget
from ..text import equations
from .command import above_zero, command, option, options
from .options import JsonOutput, RobotOptions, joint_vector, parameters
from .output import notice, show, write_json
from .track_path import PathOptions, asked_path


@options()
class GainsOptions(PathOptions):
    """Options of `ik gains`: the tracking method and its gains, and the path along which they are judged."""

    path: str | None = option("SHAPE|FILE", "circle, line, eight, or a .csv or .npz file; default: at rest alone.")
    method: str = option("NAME", "cv, av, ca, aa or aad.", "-m", "--method", default="cv")


@options()
class LateOptions:
    """Options for the delay and the noise of measured joints."""

    delay: float = option("N", "Age of measured joints that are fed back directly [samples].", default=0.0)
    noise: float | None = option("RAD", "RMS noise of the measured joints [rad or m].")


@command
def gains(asked: GainsOptions, late: LateOptions, robot: RobotOptions, out: JsonOutput) -> None:
    """Judge a tracking method's gains at a rate, at rest and along a path, and name better ones.

    Without gains the best ones at rest are judged. Without a path they are judged at rest alone, which is the same for every robot.
    With a path, the least rate from which these gains are stable along it is named as well.

    Exit code 0 when the gains are stable, 1 when they are not.

    Examples:
    ik gains planar_2r --kappa 40 --rate 50
    ik gains planar_2r --path circle --position-only --kappa 4 --rate 5
    """
    from ..robot.robot import Robot
    from ..servo.path_stability import least_rate
    from ..servo.stability import check_gains

    idle = {"--duration": asked.duration, "--position-only": asked.position_only, "--q0": asked.q0}
    if asked.shape is None and (name := next((name for name, value in idle.items() if value), None)):
        raise InvalidOption(f"{name} has no effect without --path")
    arm = robot.load(robot.choose_tips())
    along_path: dict[str, Any] = {}
    least: Any = None
    if asked.shape is not None:
        if not isinstance(arm, Robot):
            raise InvalidOption("gains are judged along the path of one tip; choose it with --tip")
        if late.delay:
            raise InvalidOption("gains with a delay are judged at rest only; omit --delay or --path")
        q0 = joint_vector(arm, asked.q0, "--q0", robot.deg)
        along_path = {"robot": arm, "path": asked_path(arm, asked, q0, {}, 1e-3).reference, "q0": q0}
    used = chosen(asked)  # Called before the division by the rate, because it refuses a rate of 0.
    check = check_gains(asked.method, 1.0 / asked.rate, delay=late.delay, noise=late.noise, **along_path, **used)
    along = None if check.along is None else check.along._asdict()
    if along_path and check.longest_step > 0.0:  # A longest step of 0 means that these gains are stable at no rate.
        arguments: dict[str, Any] = along_path | used
        least = least_rate(method=asked.method, **arguments)
    names = ("rate", "most", "at_rest", "bands", "largest_move", "message")
    rates = None if least is None else {name: getattr(least, name) for name in names}
    write_json({"robot": arm.name, **vars(check), "along": along, "rates": rates}, out.as_json)
    if not out.as_json:
        show({
            "robot": arm.name,
            "method": f"{check.method}, {equations(used)}",
            "stability": judged(check),
            "best at rest": equations(check.suggestion),
            "least rate": None if least is None else least.message,
        })  # fmt: skip
    notice(check.message)
    if not check.stable:
        raise typer.Exit(1)


def chosen(asked: PathOptions) -> dict[str, float]:
    """Return all gains of the tracking method by name: a gain that is not given as an option is the best for the sample rate."""
    from ..servo.stability import best_gains

    h = 1.0 / above_zero(asked.rate, "--rate")
    return best_gains(asked.method, h) | asked.gains | parameters(asked.param)


def judged(check: Any) -> str:
    """Return text on whether the gains of a GainCheck are stable: the spectral radius at rest, and the result along the path."""
    text = f"spectral radius {check.radius:.4g} at rest"
    if check.along is not None:
        text += f"; along the path {check.along.words}"
    return f"{check.verdict}: {text}"


def along_the_path(arm: Any, check: Any, path: Any, options: dict[str, Any], most: int = 3000) -> Any:
    """Return the check of a tracking run's gains (GainCheck), with how errors grow along the path added to it.

    The check is returned unchanged if that cannot be computed, or if the path has more than `most` samples, because it would take
    longer than the run itself.
    """
    from ..motion.reference import Reference
    from ..robot.robot import Robot
    from ..servo.stability import GAINS, check_gains

    if check is None or not isinstance(arm, Robot) or not isinstance(path, Reference) or path.duration > most * check.h:
        return check
    try:
        gains = {name: options[name] for name in GAINS[check.method] if name in options}
        return check_gains(check.method, check.h, robot=arm, path=path, **gains)
    except InvalidTarget:  # The path cannot be followed, and the report of the run says where.
        return check
