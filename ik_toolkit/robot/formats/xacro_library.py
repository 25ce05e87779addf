"""The functions and constants that xacro documents for its files, with checks of their arguments and results."""

import math
from typing import Any

from .xacro_values import LARGEST, Evaluator, Function, Refused, check_bits, power, small, total

MATH = (
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "copysign", "cos", "cosh", "degrees", "dist", "e",
    "erf", "erfc", "exp", "exp2", "expm1", "fabs", "floor", "fmod", "frexp", "fsum", "gamma", "gcd", "hypot", "inf", "isclose",
    "isfinite", "isinf", "isnan", "isqrt", "ldexp", "lgamma", "log", "log10", "log1p", "log2", "modf", "nan", "nextafter", "pi",
    "pow", "radians", "remainder", "sin", "sinh", "sqrt", "tan", "tanh", "tau", "trunc", "ulp",
)  # fmt: skip


def library(evaluator: Evaluator) -> dict[str, dict[str, Any]]:
    """Return the functions and constants that xacro expressions may use, by namespace: 'python', 'math' or '' (none)."""

    def listed(value: Any) -> list[Any]:
        return [*evaluator.members(value)]

    def kinds(kind: Any) -> tuple[type, ...]:
        every = kind if isinstance(kind, tuple) else (kind,)
        if not all(isinstance(one, Function) and one.kind for one in every):
            raise Refused("isinstance takes the names of kinds only")
        return tuple(one.kind for one in every)

    def factorial(n: int) -> int:
        check_bits(n * n if n > 0 else 0)  # The factorial of n has fewer than n^2 bits.
        return math.factorial(n)

    def rounded(value: float, digits: int | None = None, ndigits: int | None = None) -> float:
        digits = ndigits if digits is None else digits
        if digits is not None:
            small(abs(digits) * 100)
        return round(value) if digits is None else round(value, digits)

    def ranged(*given: int) -> range:
        small(len(range(*given)) if all(abs(one) < 2**62 for one in given) else LARGEST + 1)
        return range(*given)

    plain = {
        "list": lambda value=(): listed(value), "dict": dict, "len": len, "float": float, "int": int, "bool": bool,
        "map": lambda does, *given: [does(*members) for members in zip(*map(listed, given), strict=False)],
        "min": min, "max": max, "round": rounded, "range": ranged, "str": lambda value="": str(value),
        "sorted": lambda members, key=None, reverse=False: sorted(listed(members), key=key, reverse=bool(reverse)),
    }  # fmt: skip
    more = {
        "abs": abs, "all": all, "any": any, "divmod": divmod, "sum": total, "ord": ord, "repr": repr, "hash": hash,
        "enumerate": lambda value, start=0: [*enumerate(listed(value), start)],
        "filter": lambda does, value: [member for member in listed(value) if (does(member) if does else member)],
        "zip": lambda *given, strict=False: [*zip(*map(listed, given), strict=strict)],
        "reversed": lambda value: listed(value)[::-1], "tuple": lambda value=(): (*listed(value),),
        "set": lambda value=(): {*listed(value)}, "frozenset": lambda value=(): frozenset(listed(value)),
        "isinstance": lambda value, kind: isinstance(value, kinds(kind)),
    }  # fmt: skip
    stand_for = {
        "list": list, "dict": dict, "str": str, "float": float, "int": int, "bool": bool, "tuple": tuple, "set": set,
        "frozenset": frozenset, "range": range,
    }  # fmt: skip
    constants = {"True": True, "False": False}
    named = {name: Function(name, does, stand_for.get(name)) for name, does in {**plain, **more}.items()}
    numbers: dict[str, Any] = {"factorial": Function("factorial", factorial), "pow": Function("pow", power)}
    for name in MATH:
        does = getattr(math, name, None)
        if does is not None and name not in numbers:
            numbers[name] = Function(name, does) if callable(does) else does
    return {
        "": {**numbers, **{name: named[name] for name in plain}, **constants},
        "python": {**named, **constants},
        "math": numbers,
    }
