"""What `ik check` finds in a file, and how loading says it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ...errors import near_match


@dataclass(frozen=True)
class Finding:
    """One finding: severity ('error': the robot cannot be loaded; 'warning'), element ("joint 'j3'"), problem, advice, line.

    at_load: whether loading says it, too, because the robot may be another one than its author means.
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
    """Return an error."""
    return Finding("error", str(element), problem, advice, line)


def odd(element: object, problem: str, advice: str, line: int, at_load: bool = False) -> Finding:
    """Return a warning."""
    return Finding("warning", str(element), problem, advice, line, at_load)


def notes(findings: Iterable[Finding], lines: bool = True) -> tuple[str, ...]:
    """One sentence for each kind of finding that loading says (those of a kind give the same advice).

    lines: whether to say where.
    """
    kinds: dict[str, list[Finding]] = {}
    for finding in findings:
        if finding.at_load:
            kinds.setdefault(finding.advice, []).append(finding)
    said = []
    for advice, (first, *more) in kinds.items():
        where = [f"line {first.line}"] * lines + [f"{len(more)} more, see ik check"] * bool(more)
        place = f" ({'; '.join(where)})" if where else ""
        said.append(f"{first}{place}: {advice}")
    return tuple(said)


def did_you_mean(name: str, options: Iterable[str] | Mapping[str, object]) -> str:
    """Return ' Did you mean ...?' or '', without the list of all names."""
    found = near_match(name, options).partition(" Available")[0]
    return found if found.startswith(" Did") else ""
