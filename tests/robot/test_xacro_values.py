"""Expressions of xacro: what public files use is evaluated as data, everything else is refused by name and at once."""

from time import perf_counter

import pytest

from ik_toolkit.robot.formats import xacro_library, xacro_values


class Names(dict):
    """A namespace, which has dotted names and is no value."""


@pytest.fixture
def evaluate():
    evaluator = xacro_values.Evaluator()
    library = xacro_library.library(evaluator)
    names = {**library[""], "math": Names(library["math"]), "python": Names(library["python"]), "None": None}
    names |= {"fingers": ["FF", "Th"], "limits": {"elbow": {"lower": -1.5, "items": 3}}, "text": "data[12]"}
    return lambda text: evaluator.evaluate(text, names)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.9 / 2 - 0.2", 0.25),
        ("-pi/2 + radians(90)", 0.0),
        ("math.sqrt(2)**2 > 1.9 and not False", True),
        ("[f.lower() for f in fingers]", ["ff", "th"]),
        ("' '.join([str(v) for v in [1, 2.5]])", "1 2.5"),
        ("text[:-1].rsplit('[', 1)[1]", "12"),
        ("limits.elbow.lower", -1.5),
        ("limits['elbow'].lower", -1.5),
        ("limits.elbow.items()", [("lower", -1.5), ("items", 3)]),
        ("python.set('a b'.split()) - python.set(['a'])", {"b"}),
        ("python.isinstance(fingers, list) and not python.isinstance(1, (str, dict))", True),
        ("dict(a=1, **limits)['a']", 1),
        ("{k: i for i, k in python.enumerate(fingers) if i}", {"Th": 1}),
        ("max(*[1, 2], 3)", 3),
        ("python.sum([[1], [2]], [])", [1, 2]),
        ("list(map(float, '1 2'.split()))", [1.0, 2.0]),
        ("sorted(fingers, key=len, reverse=True)[-1][0]", "T"),
        ("'left' if 'x' in fingers else 'right'", "right"),
        ("1 < 2 < 3 != 4", True),
        ("1 < 2 < 1", False),
        ("1 or 2", 1),
        ("0 and 5", 0),
        ("2 < 1 < 3", False),
        ("'%s_%02d' % ('j', 3)", "j_03"),
        ("round(1.23456, 2)", 1.23),
        ("len(range(3)[1:])", 2),
        ("0x10 | 1 << 2 ^ 3 & 2", 22),
        ("None is None", True),
        ("'ab' * 2 + 'c'", "ababc"),
        ("fingers and fingers[0] or ''", "FF"),
        ("~1 // 2 % 3", 2),
    ],
)
def test_what_public_files_use(evaluate, text, value):
    assert evaluate(text) == pytest.approx(value) if isinstance(value, float) else evaluate(text) == value


HOSTILE = {
    "().__class__": "'.__class__'",
    "''.__class__.__mro__[1].__subclasses__()": "'.__class__'",
    "limits.__init__.__globals__": "'.__init__'",
    "sin.__self__": "'.__self__'",
    "sin.does": "'.does' of the function sin",
    "math.__loader__": "'.__loader__'",
    "math.sys": "'.sys' is not defined",
    "__import__('os').system('id')": "'__import__' is not allowed",
    "__builtins__": "'__builtins__' is not allowed",
    "getattr('', '__cl' + 'ass__')": "'getattr' is not defined",
    "python.type('')": "'.type' is not defined",
    "python.vars()": "'.vars' is not defined",
    "eval('1')": "'eval' is not defined",
    "open('/etc/passwd')": "'open' is not defined",
    "(lambda: 1)()": "a lambda",
    "(lambda f: f(f))(lambda f: f(f))": "a lambda",
    "f'{limits.__class__}'": "an f-string",
    "'{0.__class__}'.format(1)": "'.format'",
    "'{a.__class__}'.format_map(limits)": "'.format_map'",
    "'%(a)s' % limits": "the format",
    "'%*d' % (10**9, 1)": "the format",
    "'%999999999d' % 1": "the format",
    "(x := 1)": "an assignment",
    "[y for y in [(x := 1)]]": "an assignment",
    "(await 1)": "await",
    "(yield 1)": "yield",
    "(i for i in [1]).gi_frame": "'.gi_frame' of a value of the kind list",
    "[].append.__self__": "'.append'",
    "[*[1]] if (*fingers,) else fingers.clear()": None,
    "b'bytes'": "kind bytes",
    "1j": "kind complex",
    "(-8) ** 0.5": "kind complex",
    "...": "kind ellipsis",
    "1 @ 2": "the operator @",
    "math": "kind Names",
    "[math]": "kind Names",
    "dict(math)": "kind Names",
    "import os": "not an expression",
    "9**9**9": "4,096 bits",
    "(2**4000) * (2**4000)": "4,096 bits",
    "1 << 10**9": "4,096 bits",
    "math.factorial(10**6)": "4,096 bits",
    "pow(10, 10**9)": "4,096 bits",
    "0x" + "f" * 5000: "4,096 bits",
    "'a' * 10**10": "100,000 characters",
    "[[0] * 1000] * 10**6": "100,000 characters",
    "[[[[[0] * 60] * 60] * 60] * 60]": "100,000 characters",
    "'a'.ljust(10**10)": "100,000 characters",
    "'1'.zfill(10**10)": "100,000 characters",
    "'a'.center(10**10, 'b')": "100,000 characters",
    "('a' * 90000).replace('a', 'b' * 90000)": "100,000 characters",
    "('a' * 90000).join('b' * 90000)": "100,000 characters",
    "'\\t'.expandtabs(10**10)": "'.expandtabs'",
    "'a'.translate({97: 'b' * 10})": "'.translate'",
    "'a'.encode()": "'.encode'",
    "python.sum([[0] * 1000] * 90, [0])": None,
    "python.sum([fingers * 10000] * 90, [])": "100,000 characters",
    "range(10**18)": "100,000 characters",
    "range(10**40)": "100,000 characters",
    "round(5, -10**9)": "100,000 characters",
    "[i for i in range(99999) for j in range(99999)]": "steps",
    "len([0 for a in 'abcdefgh' * 9 for b in 'abcdefgh' * 9 for c in 'abcdefgh' * 9 for d in 'abc'])": "steps",
    "-" * 3000 + "1": "nested too deep",
    "(" * 150 + "1" + ")" * 150: None,
    "[" * 150 + "1" + "]" * 150: "nested more than",
    "+".join(["1"] * 3000): "nested",
    "1" * 30000: "20,000 characters",
    "limits.wrist": "no key 'wrist'",
    "limits['wrist']": "no key 'wrist'",
    "fingers.lower()": "'.lower' of a value of the kind list",
    "fingers()": "is not a function",
    "1 +": "not an expression",
    "1 / 0": "division by zero",
    "nobody": "'nobody' is not defined",
}


@pytest.mark.parametrize("text", HOSTILE)
def test_nothing_else_is_evaluated(evaluate, text):
    """Each is refused in words, or is data; none takes a second, though several would take hours or the memory."""
    began = perf_counter()
    if HOSTILE[text] is None:
        assert isinstance(evaluate(text), list | int)
    else:
        with pytest.raises(xacro_values.Refused) as caught:
            evaluate(text)
        assert HOSTILE[text] in caught.value.args[0]
        assert caught.value.args[1] == text  # the message names the expression
    assert perf_counter() - began < 5.0


def test_a_file_has_so_many_steps_and_no_more(evaluate):
    with pytest.raises(xacro_values.Refused, match="steps to expand"):
        for _ in range(1_000):
            evaluate("[i * i for i in range(99)]")
