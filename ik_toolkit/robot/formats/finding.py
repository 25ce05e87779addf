"""A problem that `ik check` finds in a robot description, and the sentences in which loading reports such problems."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ...errors import near_match
from ...text import in_shell


@dataclass(frozen=True)
class Finding:
    """One problem found in a robot description.

    `severity` is 'error' if the robot cannot be loaded, otherwise 'warning'. `element` is a text such as "joint 'j3'", `line` its
    line in the file, from 1. `at_load` marks warnings that `Robot.load` logs, too, because the robot may move differently from
    what its author means.
    """

    severity: str
    element: str
    problem: str
    advice: str
    line: int = 0
    at_load: bool = False

    def __str__(self) -> str:
        """Return element and problem in one sentence."""
        return f"{self.element}: {self.problem}"


def error_finding(element: object, problem: str, advice: str, line: int) -> Finding:
    """Return a Finding of severity 'error', with which the robot cannot be loaded."""
    return Finding("error", str(element), problem, advice, line)


def odd(element: object, problem: str, advice: str, line: int, at_load: bool = False) -> Finding:
    """Return a Finding of severity 'warning', with which the robot can be loaded."""
    return Finding("warning", str(element), problem, advice, line, at_load)


def notes(findings: Iterable[Finding], lines: bool = True) -> tuple[str, ...]:
    """Return a sentence for each finding that is logged when a robot is loaded; findings with the same advice share one.

    lines: whether to give line numbers of the file.
    """
    kinds: dict[str, list[Finding]] = {}
    for finding in findings:
        if finding.at_load:
            kinds.setdefault(finding.advice, []).append(finding)
    said = []
    for advice, (first, *more) in kinds.items():
        where = [f"line {first.line}"] * lines + [f"{len(more)} more, see {in_shell('ik check')}"] * bool(more)
        place = f" ({'; '.join(where)})" if where else ""
        said.append(f"{first}{place}: {advice}")
    return tuple(said)


def did_you_mean(name: str, options: Iterable[str] | Mapping[str, object]) -> str:
    """Return ' Did you mean ...?' with that of the options which is most like a misspelled name, or '' if none is like it."""
    found = near_match(name, options).partition(" Available")[0]
    return found if found.startswith(" Did") else ""
