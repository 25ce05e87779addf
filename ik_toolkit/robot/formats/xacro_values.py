"""Evaluates xacro's expressions by a walk over their syntax tree, without Python's `eval`.

Only these values are allowed: numbers, texts, lists, tuples, dicts, sets and ranges of values, None, and the functions below.
Steps and sizes are counted, so that a file cannot keep the process busy.
"""

import ast
import operator
import re
from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

STEPS = 150_000  # Limit on the evaluation steps of a whole file. The largest xacro robot of the package rtb-data takes 3,000.
LONGEST = 20_000  # Limit on the characters of a text with expressions.
LARGEST = 100_000  # Limit on the characters and members of a value; shared ones count as often as they appear.
BITS = 4096  # Limit on the bits of a whole number.
DEEP = 60  # Limit on the nesting of an expression, and of lists.
WIDTH = 99  # Limit on the width of a formatted number.
PLAIN = (bool, int, float, str, type(None))
METHODS: dict[type, tuple[str, ...]] = {
    str: (
        "capitalize", "casefold", "center", "count", "endswith", "find", "index", "isalnum", "isalpha", "isdecimal", "isdigit",
        "isidentifier", "islower", "isnumeric", "isspace", "istitle", "isupper", "join", "ljust", "lower", "lstrip", "partition",
        "removeprefix", "removesuffix", "replace", "rfind", "rindex", "rjust", "rpartition", "rsplit", "rstrip", "split",
        "splitlines", "startswith", "strip", "swapcase", "title", "upper", "zfill",
    ),
    list: ("copy", "count", "index"),
    tuple: ("count", "index"),
    dict: ("copy", "get", "items", "keys", "values"),
    set: ("copy", "difference", "intersection", "isdisjoint", "issubset", "issuperset", "symmetric_difference", "union"),
    float: ("is_integer",),
}  # fmt: skip
FORMAT = re.compile(rf"%[-+ #0]*(\d{{1,{len(str(WIDTH))}}})?(\.\d{{1,{len(str(WIDTH))}}})?[diouxXeEfFgGsr%]")
# Kinds of Python expression that are not allowed in xacro files, with the names that messages give them.
WORDS = {
    ast.Lambda: "a lambda", ast.JoinedStr: "an f-string", ast.NamedExpr: "an assignment", ast.Await: "await", ast.Yield: "yield",
    ast.YieldFrom: "yield", ast.Starred: "a star", ast.MatMult: "the operator @",
}  # fmt: skip


class Refused(Exception):
    """Raised for a xacro file that uses something that is not allowed, or exceeds a limit; the message says what."""


class Function:
    """A function that xacro expressions may call, and may pass to `map` and similar functions."""

    def __init__(self, name: str, does: Callable[..., Any], kind: type | None = None, weighed: bool = False) -> None:
        """Store name, Python function, type for `isinstance`, and whether it checks the size of its own result."""
        self.name, self.does, self.kind, self.weighed = name, does, kind, weighed

    def __call__(self, *given: Any, **named: Any) -> Any:
        """Call the function and return its value."""
        return self.does(*given, **named)

    def __repr__(self) -> str:
        """Return the name of the function."""
        return self.name


class Evaluator:
    """Evaluates the expressions of one xacro file without `eval`, and counts steps, so that none runs too long."""

    def __init__(self) -> None:
        """Begin with no step counted."""
        self.left = STEPS

    def spend(self, steps: int = 1) -> None:
        """Add steps to the count of the whole file. Raises Refused if they are too many."""
        self.left -= steps
        if self.left < 0:
            raise Refused(f"it takes more than {STEPS:,} steps to expand")

    def evaluate(self, text: str, names: Mapping[str, Any]) -> Any:
        """Return the value of an expression, given the values of names that it may use. Raises Refused, which quotes it."""
        try:
            if len(text) > LONGEST:
                raise Refused(f"an expression has more than {LONGEST:,} characters")
            self.spend(1 + len(text) // 100)
            value = self.value(ast.parse(text.strip(), mode="eval").body, names, 0)
            # All other types were checked while the value was computed; only a namespace of xacro must be refused here.
            if isinstance(value, Mapping) and type(value) is not dict:
                raise Refused(f"it makes {_called(value)}, which is not allowed")
            return value
        except Refused as error:
            raise (error if len(error.args) > 1 else Refused(*error.args, text)) from None
        except SyntaxError as error:
            raise Refused(f"it is not an expression: {error.msg}", text) from None
        except KeyError as error:
            raise Refused(f"there is no key {error}", text) from None
        except (RecursionError, MemoryError):
            raise Refused("it is nested too deep", text) from None
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise Refused(str(error) or type(error).__name__, text) from None

    def value(self, node: ast.expr, names: Mapping[str, Any], depth: int) -> Any:
        """Return the value of one node of the syntax tree (ast) of an expression."""
        self.spend()
        if depth > DEEP:
            raise Refused(f"it is nested more than {DEEP} deep")
        kind = type(node)
        if kind in WORDS or not hasattr(self, f"of_{kind.__name__}"):
            raise Refused(f"it uses {WORDS.get(kind, kind.__name__)}, which is not evaluated")
        return getattr(self, f"of_{kind.__name__}")(node, names, depth + 1)

    def checked(self, value: Any) -> Any:
        """Return a value unchanged if its type is allowed and it is not too large. Raises Refused otherwise."""
        weight = _weight(value)
        self.spend(weight // 50)
        return value

    def of_Constant(self, node: ast.Constant, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        return self.checked(node.value)

    def of_Name(self, node: ast.Name, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        if node.id.startswith("__"):
            raise Refused(f"the name '{node.id[:60]}' is not allowed")
        try:
            return names[node.id]
        except KeyError:
            raise Refused(f"the name '{node.id[:60]}' is not defined") from None

    def of_Attribute(self, node: ast.Attribute, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        owner, name = self.value(node.value, names, depth), node.attr
        if name.startswith("_"):
            raise Refused(f"it uses '.{name[:60]}', which is not allowed")
        # A mapping that is not a plain dict is a namespace of xacro.
        if isinstance(owner, Mapping) and type(owner) is not dict:
            try:
                return owner[name]
            except KeyError:
                raise Refused(f"the name '.{name[:60]}' is not defined") from None
        kind = set if isinstance(owner, frozenset) else type(owner)
        if name in METHODS.get(kind, ()):
            return Function(name, lambda *given, **named: self._method(owner, name, given, named))
        if isinstance(owner, dict):
            if name in owner:
                return owner[name]
            raise Refused(f"there is no key '{name[:60]}'")
        raise Refused(f"it uses '.{name[:60]}' of {_called(owner)}, which is not allowed")

    def _method(self, owner: Any, name: str, given: tuple, named: dict) -> Any:
        """Call a method of a value after checking how large its result can become."""
        if isinstance(owner, str):
            size = len(owner)
            if name in ("center", "ljust", "rjust", "zfill") and given and isinstance(given[0], int):
                size = given[0]
            elif name == "replace" and len(given) > 1 and all(isinstance(text, str) for text in given[:2]):
                size = len(owner) + owner.count(given[0]) * len(given[1])
            elif name == "join" and len(given) == 1:
                given = ([*self.members(given[0])],)
                size = len(owner) * len(given[0]) + sum(len(text) for text in given[0] if isinstance(text, str))
            small(size)
        made = getattr(owner, name)(*given, **named)
        return list(made) if name in ("items", "keys", "values") else made

    def members(self, value: Any) -> Iterable[Any]:
        """Return the members of a value and count each as a step."""
        if not isinstance(value, str | list | tuple | dict | set | frozenset | range):
            raise Refused(f"{_called(value)} has no members")
        self.spend(len(value))
        return value

    def of_Call(self, node: ast.Call, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        does = self.value(node.func, names, depth)
        if not isinstance(does, Function):
            raise Refused(f"{_called(does)} is not a function")
        given: list[Any] = []
        for argument in node.args:
            if isinstance(argument, ast.Starred):
                given += self.members(self.value(argument.value, names, depth))
            else:
                given.append(self.value(argument, names, depth))
        named: dict[str, Any] = {}
        for word in node.keywords:
            value = self.value(word.value, names, depth)
            if word.arg is None and type(value) is not dict:
                raise Refused(f"{_called(value)} cannot follow **")
            named |= value if word.arg is None else {word.arg: value}
        for value in (*given, *named.values()):
            self.checked(value)
        made = does(*given, **named)
        return made if does.weighed else self.checked(made)

    def of_BinOp(self, node: ast.BinOp, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        left, right = self.value(node.left, names, depth), self.value(node.right, names, depth)
        kind = type(node.op)
        if kind not in BINARY:
            raise Refused(f"it uses {WORDS.get(kind, kind.__name__)}, which is not evaluated")
        return self.checked(BINARY[kind](left, right))

    def of_UnaryOp(self, node: ast.UnaryOp, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        return UNARY[type(node.op)](self.value(node.operand, names, depth))

    def of_BoolOp(self, node: ast.BoolOp, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        value: Any = None
        for part in node.values:
            value = self.value(part, names, depth)
            if bool(value) != isinstance(node.op, ast.And):
                break
        return value

    def of_IfExp(self, node: ast.IfExp, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        return self.value(node.body if self.value(node.test, names, depth) else node.orelse, names, depth)

    def of_Compare(self, node: ast.Compare, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        left, holds = self.value(node.left, names, depth), True
        for how, part in zip(node.ops, node.comparators, strict=True):
            right = self.value(part, names, depth)
            if isinstance(right, str | list | tuple | range):
                self.spend(len(right) // 20)
            holds = COMPARE[type(how)](left, right)
            if not holds:
                break
            left = right
        return holds

    def of_Subscript(self, node: ast.Subscript, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        owner = self.value(node.value, names, depth)
        if not isinstance(owner, str | list | tuple | range) and type(owner) is not dict:
            raise Refused(f"{_called(owner)} cannot be indexed")
        if not isinstance(node.slice, ast.Slice):
            return owner[self.value(node.slice, names, depth)]
        parts = (node.slice.lower, node.slice.upper, node.slice.step)
        made = owner[slice(*(part and self.value(part, names, depth) for part in parts))]
        self.spend(len(made) // 20)
        return made

    def of_List(self, node: ast.List | ast.Tuple | ast.Set, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        made: list[Any] = []
        for part in node.elts:
            star = isinstance(part, ast.Starred)
            value = self.value(part.value if isinstance(part, ast.Starred) else part, names, depth)
            made += self.members(value) if star else [value]
        self.checked(made)
        return {ast.Tuple: tuple, ast.Set: set}.get(type(node), list)(made)

    of_Tuple = of_Set = of_List

    def of_Dict(self, node: ast.Dict, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        made: dict[Any, Any] = {}
        for key, part in zip(node.keys, node.values, strict=True):
            value = self.value(part, names, depth)
            if key is None and type(value) is not dict:
                raise Refused(f"{_called(value)} cannot follow **")
            made |= value if key is None else {self.value(key, names, depth): value}
        return self.checked(made)

    def of_ListComp(self, node: ast.ListComp | ast.GeneratorExp, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        return self.checked(
            [self.value(node.elt, inner, depth) for inner in self._loops(node.generators, names, depth)]
        )

    of_GeneratorExp = of_ListComp

    def of_SetComp(self, node: ast.SetComp, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        made = {self.value(node.elt, inner, depth) for inner in self._loops(node.generators, names, depth)}
        return self.checked(made)

    def of_DictComp(self, node: ast.DictComp, names: Mapping[str, Any], depth: int) -> Any:  # noqa: D102
        loops = self._loops(node.generators, names, depth)
        return self.checked(
            {self.value(node.key, inner, depth): self.value(node.value, inner, depth) for inner in loops}
        )

    def _loops(
        self, loops: Sequence[ast.comprehension], names: Mapping[str, Any], depth: int
    ) -> Iterable[Mapping[str, Any]]:
        """Yield the names that are visible in each turn of a comprehension's loops."""
        if not loops:
            yield names
            return
        first, *rest = loops
        if first.is_async:
            raise Refused("it uses async, which is not evaluated")
        for member in self.members(self.value(first.iter, names, depth)):
            inner = ChainMap(_unpacked(first.target, member), names)  # type: ignore[arg-type]  names is only read
            if all(self.value(test, inner, depth) for test in first.ifs):
                yield from self._loops(rest, inner, depth)


def _unpacked(target: ast.expr, value: Any) -> dict[str, Any]:
    """Assign a value, or its members, to the loop variable or variables of a comprehension; return values by name."""
    if isinstance(target, ast.Name):
        return {target.id: value}
    if isinstance(target, ast.Tuple | ast.List) and isinstance(value, list | tuple | str):
        own: dict[str, Any] = {}
        for part, member in zip(target.elts, value, strict=True):
            own |= _unpacked(part, member)
        return own
    raise Refused(f"a loop cannot unpack {_called(value)} this way")


def _called(value: Any) -> str:
    """Return what a value is called in messages."""
    return f"the function {value}" if isinstance(value, Function) else f"a value of the kind {type(value).__name__}"


def _weight(value: Any, so_far: int = 0, depth: int = 0) -> int:
    """Add the number of characters and members of a value to `so_far`. Raises Refused for too many or a type not allowed."""
    if isinstance(value, str | range):
        so_far += len(value)
    elif isinstance(value, int):
        check_bits(value.bit_length())
        so_far += value.bit_length() // 32
    elif isinstance(value, list | tuple | set | frozenset) or type(value) is dict:
        if depth > DEEP:
            raise Refused(f"a list is nested more than {DEEP} deep")
        for member in value:
            so_far = _weight(member, so_far + 1, depth + 1)
        for member in value.values() if isinstance(value, dict) else ():
            so_far = _weight(member, so_far, depth + 1)
    elif not isinstance(value, PLAIN) and not isinstance(value, Function):
        raise Refused(f"it makes {_called(value)}, which is not allowed")
    small(so_far)
    return so_far


def small(size: int) -> None:
    """Raise Refused if a value has too many characters or members."""
    if size > LARGEST:
        raise Refused(f"a value has more than {LARGEST:,} characters or members")


def check_bits(bits: int) -> None:
    """Raise Refused if a whole number has too many bits."""
    if bits > BITS:
        raise Refused(f"a whole number has more than {BITS:,} bits")


def power(base: Any, exponent: Any) -> Any:
    """Compute a power, unless the result would be too large."""
    if isinstance(base, int) and isinstance(exponent, int) and exponent > 0:
        check_bits((base.bit_length() - 1) * exponent if abs(base) > 1 else 0)
    return base**exponent


def multiply(left: Any, right: Any) -> Any:
    """Compute a product, or repeat a text or list, unless the result would be too large."""
    for one, times in ((left, right), (right, left)):
        if isinstance(one, str | list | tuple) and isinstance(times, int):
            small(len(one) * times)
    return left * right


def total(values: Iterable[Any], start: Any = 0) -> Any:
    """Compute a sum; lists are joined in one go, because each partial sum would be copied."""
    if type(start) is list:
        made = [*start]
        for value in values:
            if type(value) is not list:
                raise Refused(f"a list and {_called(value)} cannot be added")
            made += value
            small(len(made))
        return made
    return sum(values, start)


def remainder(left: Any, right: Any) -> Any:
    """Compute a remainder, or format a text as printf does, with widths up to 99 and without names or stars."""
    if isinstance(left, str):
        if "%" in FORMAT.sub("", left):
            raise Refused(f"the format {left[:40]!r} is not allowed")
        small(len(left) + 10 * _weight(right) + (WIDTH + 1) * left.count("%"))
    return left % right


def shifted(left: Any, right: Any) -> Any:
    """Shift a whole number to the left, unless the result would be too large."""
    if isinstance(left, int) and isinstance(right, int):
        check_bits(left.bit_length() + right)
    return left << right


BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: multiply, ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv,
    ast.Mod: remainder, ast.Pow: power, ast.LShift: shifted, ast.RShift: operator.rshift, ast.BitOr: operator.or_,
    ast.BitAnd: operator.and_, ast.BitXor: operator.xor,
}  # fmt: skip
UNARY: dict[type, Callable[[Any], Any]] = {
    ast.Not: operator.not_, ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Invert: operator.invert,
}  # fmt: skip
COMPARE: dict[type, Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt,
    ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not, ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}  # fmt: skip
