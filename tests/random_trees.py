"""Random URDFs with branches whose joints lead and follow each other, for trees of two or three tips from any base."""

from typing import NamedTuple

from second_fk import SecondFK, _angle, _axis, _limits, _mimic, _triple


class TreeCase(NamedTuple):
    """One random tree: what Tree.load takes."""

    text: str
    base: str
    tips: list

    def judges(self):
        """The second FK of each tip."""
        return [SecondFK(self.text, self.base, tip) for tip in self.tips]


def random_tree(rng):
    """A robot of 2 to 9 independent joints on branches, followers on any of them, lengths of 1e-4 to 1e3 m in some."""
    size = 10.0 ** rng.uniform(-4.0, 3.0) if rng.random() < 0.3 else 10.0 ** rng.uniform(-1.0, 0.5)
    count, links, parts, leaders = int(rng.integers(2, 10)), ["l0"], ['<link name="l0"/>'], []
    while len(leaders) < count:
        i = len(parts) - 1
        kind = str(rng.choice(["revolute", "revolute", "revolute", "continuous", "prismatic", "fixed"]))
        parent, child = links[-1] if rng.random() < 0.7 else links[int(rng.integers(len(links)))], f"l{i + 1}"
        mimic, limit, between = "", "", (-30.0, 30.0)
        if kind in ("revolute", "prismatic"):
            between = _limits(rng, kind, size)
        if kind != "fixed" and leaders and rng.random() < 0.35:
            mimic, between = _mimic(rng, *leaders[int(rng.integers(len(leaders)))], kind, size)
        elif kind != "fixed":
            leaders.append((f"j{i}", kind, between))
        if kind in ("revolute", "prismatic"):
            limit = f'<limit lower="{between[0]!r}" upper="{between[1]!r}" effort="1" velocity="1"/>'
        rpy = " ".join(_angle(rng) if rng.random() < 0.6 else "0" for _ in range(3))
        parts.append(
            f'<link name="{child}"/><joint name="j{i}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{_triple(rng, size)}" rpy="{rpy}"/><axis xyz="{_axis(rng)}"/>{limit}{mimic}</joint>'
        )
        links.append(child)
    text = f'<robot name="random">{"".join(parts)}</robot>'
    base = links[int(rng.integers(len(links)))]
    judges = [SecondFK(text, base, link) for link in links]
    moved = [one.tip for one in judges if any(one.kind(name) != "fixed" for name in one.down)]
    if len(moved) < 2:
        base, moved = "l0", links[1:]
    return TreeCase(text, base, [str(x) for x in rng.permutation(moved)[: int(rng.integers(2, 4))]])
