"""Subprocess that expands xacro for `xacro.py`; expressions are evaluated by xacro_values.py, never as Python.

Its job (JSON on stdin) has file, arguments (name -> value), package_dirs, folders (files are read only from these and from
packages that are found), environment (ROS package path variables), memory [bytes] and seconds. It prints one line of JSON:
{"urdf": text, "asked": names} or {"error": sentence}.
"""

import contextlib
import glob
import io
import itertools
import json
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

# This file runs as a script, so the package is importable only if its parent folder is on sys.path.
sys.path.append(str(Path(__file__).parents[3]))
from ik_toolkit.errors import near_match
from ik_toolkit.robot.formats.sandbox import limit
from ik_toolkit.robot.formats.xacro_files import CAPS, Files
from ik_toolkit.robot.formats.xacro_library import library
from ik_toolkit.robot.formats.xacro_values import LARGEST, LONGEST, Evaluator, Function, Refused
from ik_toolkit.robot.packages import find_package

FILES = 1_000  # An <xacro:include> with wildcards reads at most this many files.
# A regular expression for the parameters of a xacro macro. That of xacro itself has nested repetition, which can take exponential
# time.
DEFAULTS = re.compile(
    r"""^\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(\$\{.*?\}|\$\(.*?\)|(?:'.*?'|".*?"|[^\s'"])+|)(?:\s+|$)(.*)"""
)


class GivenArguments(dict):
    """Arguments of a xacro file that remember which names were asked for, so that a misspelled one can be reported."""

    def __init__(self, given: dict[str, str]) -> None:
        """Store the arguments; no name has been asked for yet."""
        super().__init__(given)
        self.names: set[str] = set()

    def __contains__(self, name: object) -> bool:
        """Return whether there is an argument of this name, and remember the name."""
        self.names.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        """Return the argument of this name and remember the name.

        Raises Refused, which says how to give the argument.
        """
        if name not in self:
            shown = str(name)[:60]
            raise Refused(
                f"the argument '{shown}' has no value; give it with xacro_args={{'{shown}': ...}}, in the shell with "
                f"--xacro-arg {shown}:=VALUE"
            )
        return super().__getitem__(name)


class Expansion:
    """Runs the Python module xacro, with safe functions for those that would evaluate Python or read files without limits."""

    def __init__(self, job: dict) -> None:
        """Store the job and replace the functions of xacro."""
        import xacro
        import xacro.substitution_args as substitution

        self.job, self.xacro = job, xacro
        self.files = Files(job["folders"])
        self.evaluator, self.arguments = Evaluator(), GivenArguments(job["arguments"])
        self.known: dict[str, str] = {}  # The folders of the ROS packages found so far, by name of package.
        self.written = 0
        # For each macro, by id() of its body: the body, and how many evaluation steps a copy of it counts.
        self.bodies: dict[int, tuple[Any, int]] = {}
        plain = library(self.evaluator)
        self.symbols: dict[str, Any] = {**plain[""], "None": None}
        own = {name: Function(name, does, weighed=name == "load_yaml") for name, does in self.own().items()}
        self.symbols |= own
        for name, inside in {**plain, "xacro": own}.items():
            if name:
                self.symbols[name] = xacro.NameSpace()
                self.symbols[name].update(inside)
        for name in ("arg", "message", "warning", "error", "print_location", "fatal", "tokenize"):
            del self.symbols[name]  # An expression may call these functions only as xacro.NAME.
        self.original: dict[str, Any] = vars(xacro).copy()
        self._replace_in(
            xacro,
            eval_all=self.eval_all,
            eval_text=self.eval_text,
            resolve_macro=self.resolve_macro,
            replace_node=self.replace_node,
            re_macro_arg=DEFAULTS,
            safe_eval=lambda text, names, locals=None: self.evaluator.evaluate(str(text), names),
            load_yaml=self.load_yaml,
            parse=self.parse,
            get_include_files=self.included,
            abs_filename_spec=self.absolute,
            _global_symbols=self.symbols,
        )
        self._replace_in(
            substitution,
            _eval=self.eval_eval,
            _eval_arg=lambda name, args: args[name],
            _eval_dirname=self.dirname,
            _eval_env=self.env,
            _eval_find=self.find,
            _eval_optenv=lambda name, default="": self.arguments[name] if name in self.arguments else default,
        )

    def _replace_in(self, module: Any, **functions: Any) -> None:
        """Replace functions of a module of xacro. Raises Refused if it has none of a name, because it would then be unsafe."""
        for name in functions:
            if not hasattr(module, name):
                raise Refused(f"this version of xacro has no {name}; install the version that the toolkit knows")
        vars(module).update(functions, **dict.fromkeys(("eval", "exec", "compile", "open"), _never))

    def own(self) -> dict[str, Callable[..., Any]]:
        """Return by name the functions that expressions may call as xacro.NAME."""

        def silent(*given: Any, **named: Any) -> str:
            return ""

        def fatal(*given: Any) -> None:
            raise Refused(" ".join(map(str, given))[:300])

        def tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
            return [part for part in re.split(f"[{re.escape(sep)}]", text) if part or not skip_empty]

        return {
            "load_yaml": self.load_yaml,
            "abs_filename": self.absolute,
            # xacro's `dotify` lets d.key stand for d["key"]. Here every dict allows that, so there is nothing to do.
            "dotify": lambda value: value,
            "arg": lambda name: self.arguments[name],
            **dict.fromkeys(("message", "warning", "error", "print_location"), silent),
            "fatal": fatal,
            "tokenize": tokenize,
        }

    def eval_all(self, node: Any, macros: Any, symbols: Any) -> None:
        """Replace `eval_all` of xacro: expand the children of an element, which count as steps towards a limit for the file."""
        self.evaluator.spend(4 + len(node.childNodes))
        self.original["eval_all"](node, macros, symbols)

    def resolve_macro(self, name: str, macros: Any, symbols: Any) -> Any:
        """Replace `resolve_macro` of xacro: return a macro. Copying its body counts as steps towards a limit for the file."""
        try:
            found = self.original["resolve_macro"](name, macros, symbols)
        except KeyError:
            known, table = list[str](), macros
            while table is not None:
                known, table = [*known, *table], getattr(table, "parent", None)
            raise Refused(f"there is no macro '{name[:100]}'.{near_match(name, known)}") from None
        body = found[2].body
        if id(body) not in self.bodies:
            self.bodies[id(body)] = body, _weight(body)
        self.evaluator.spend(self.bodies[id(body)][1])
        return found

    def replace_node(self, node: Any, by: Any, content_only: bool = False) -> None:
        """Replace `replace_node` of xacro: put nodes in the place of one, which counts as steps towards a limit for the file."""
        others = by if isinstance(by, list) else [by] if by is not None else []
        parts = sum(len(other.childNodes) if content_only else 1 for other in others)
        self.evaluator.spend((1 + parts) * (parts + len(node.parentNode.childNodes)) // 100)
        self.original["replace_node"](node, by, content_only)

    def eval_text(self, text: str, symbols: Any) -> Any:
        """Replace `eval_text` of xacro: evaluate a text with ${...} and $(...), within limits on its length and steps."""
        if "$" not in text:
            return text
        if len(text) > LONGEST:
            raise Refused(f"a text with expressions has more than {LONGEST:,} characters")
        self.evaluator.spend(1 + len(text) // 50)
        made = self.original["eval_text"](text, symbols)
        if isinstance(made, str):
            self.written += len(made)
            if len(made) > LARGEST or self.written > CAPS.bytes:
                raise Refused(f"a text of more than {LARGEST:,} characters is put together, or too many")
        return made

    def eval_eval(self, text: str, context: dict) -> str:
        """Return, as text, the value of $(eval ...), an expression in which arguments of the file are names."""
        arguments = self.arguments

        class Names(dict):
            def __missing__(self, name: str) -> Any:
                return _converted(arguments[name])

        functions = {"arg": lambda name: _converted(self.arguments[name]), "env": self.env, "find": self.find}
        functions |= {"optenv": lambda name, default="": self.arguments.get(name, default), "dirname": self.dirname}
        own = {name: Function(name, does) for name, does in functions.items()}
        own |= {**self.symbols, "true": True, "false": False}
        return str(self.evaluator.evaluate(text, Names(own)))

    def find(self, name: str) -> str:
        """Return the folder of a ROS package by name, and allow files to be read from it from now on."""
        if name not in self.known:
            found = find_package(name, Path(self.job["file"]), self.job["package_dirs"], self.job["environment"])
            if found is None:
                raise Refused(
                    f"there is no package '{name[:100]}'; name its folder, the one with its package.xml, with "
                    "package_dirs=[...], in the shell with --package-dir"
                )
            self.known[name] = str(found)
            self.files.folders.append(str(found))
        return self.known[name]

    def env(self, name: str) -> str:
        """Return the value of $(env NAME): the argument of this name that the user gave, never an environment variable."""
        if name not in self.arguments:
            raise Refused(
                f"it reads $(env {name[:100]}); the environment is not read, give {name[:100]} as an argument"
            )
        return self.arguments[name]

    def dirname(self, _: Any = None) -> str:
        """Return the value of $(dirname), the folder of the file being expanded."""
        return os.path.dirname(os.path.abspath(self.xacro.filestack[-1]))

    def absolute(self, name: str) -> str:
        """Return the absolute path of a file named relative to the xacro file, as file://... or as package://..."""
        scheme, _, rest = str(name).partition("://")
        if scheme == "file":
            return rest
        if scheme != "package":
            return self.original["abs_filename_spec"](str(name))
        package, _, inner = rest.partition("/")
        return os.path.join(self.find(package), inner)

    def included(self, name: str, symbols: Any) -> Any:
        """Yield the paths of the files that an <xacro:include> names, maybe by a pattern with wildcards."""
        path = self.absolute(str(self.xacro.eval_text(name, symbols)))
        found = [path]
        if re.search("[*?[]", path):
            found = sorted(itertools.islice(glob.iglob(path), FILES))
        yield from found

    def parse(self, text: Any, filename: str | None = None) -> Any:
        """Replace `parse` of xacro: return a xacro file as an XML document, read within the limits."""
        assert filename is not None
        try:
            document = self.files.xml(filename)
        except OSError as error:
            self.xacro.filestack.pop()
            raise self.xacro.XacroException(exc=error) from None
        for element in document.getElementsByTagName("xacro:arg"):
            # xacro refuses an argument without a default even if its value is given, so an empty default is added.
            if not element.hasAttribute("default"):
                if element.getAttribute("name") in self.arguments:
                    element.setAttribute("default", "")
                else:
                    element.parentNode.removeChild(element)
        return document

    def load_yaml(self, name: str) -> Any:
        """Replace `load_yaml` of xacro: return the contents of a YAML file as dicts, lists, numbers and texts."""
        path = self.absolute(name)
        self.xacro.filestack.append(path)
        made = self.files.yaml(path, lambda text: float(self.evaluator.evaluate(text, self.symbols)))
        self.xacro.filestack.pop()
        return made


def _weight(node: Any) -> int:
    """Return the cost of copying a node, in steps."""
    own = len(node.data) // 100 if node.nodeType in (node.TEXT_NODE, node.COMMENT_NODE) else 1
    return own + sum(map(_weight, node.childNodes))


def _never(*_: object, **__: object) -> None:
    raise Refused("it uses a feature of xacro that is not allowed here")


def _converted(text: str) -> Any:
    """Return an argument as a number or truth value if it is one."""
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return {"true": True, "false": False}.get(text.lower(), text)


def run_job(job: dict) -> dict:
    """Expand the xacro file of a job (see `expand` in xacro.py); return a dict with the text, or with the error as a sentence."""
    stack: list[str] = []
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            expansion = Expansion(job)
            os.environ.clear()
            document: Any = expansion.xacro.process_file(job["file"], mappings=expansion.arguments)
            return {"urdf": document.toprettyxml(indent="  "), "asked": sorted(expansion.arguments.names)}
    except BaseException as error:  # A broken macro can raise an exception of any type.
        cause: Any = error
        while isinstance(getattr(cause, "exc", None), BaseException):
            cause = cause.exc
        stack = [os.path.basename(name) for name in (sys.modules["xacro"].filestack or []) if name]
        return {"error": told(cause, stack)}


def told(cause: BaseException, stack: list[str]) -> str:
    """Return one sentence on the error that ended the expansion, and where: `stack` has the names of the open files."""
    said = " ".join(str(cause.args[0] if isinstance(cause, Refused) else cause).split())[:300]
    where = f"'{stack[-1]}'" if stack else ""
    macros = sys.modules["xacro"].macrostack
    name = macros[-1].body.getAttribute("name")[:60] if macros else ""
    if isinstance(cause, Refused) and len(cause.args) > 1:
        text = " ".join(str(cause.args[1]).split())
        where = f"in the expression '{text[:60]}{'...' * (len(text) > 60)}'" + (f" of {where}" if where else "")
        return f"{said}, {where}"
    if isinstance(cause, FileNotFoundError):
        others = [name for name in stack if name != os.path.basename(cause.filename)]
        said, where = f"there is no file '{cause.filename}'", f"'{others[-1]}'" if others else ""
    elif isinstance(cause, RecursionError):
        said = f"the macro '{name}' calls itself without end (recursion)" if name else "endless recursion"
    elif isinstance(cause, MemoryError):
        said = "it needs too much memory"
    elif name:
        where = f"the macro '{name}' of {where}"
    said = said or type(cause).__name__
    return f"{said} (in {where})" if where else said


def _main() -> None:
    """Read the job from stdin and write the answer to stdout."""
    job = json.load(sys.stdin)
    limit("CORE", 0)
    limit("AS", job["memory"])
    limit("CPU", job["seconds"])
    # Files write a loop as a macro that calls itself. Each pass nests ten Python calls deeper, so the usual limit is too low.
    sys.setrecursionlimit(3000)
    print(json.dumps(run_job(job)))


if __name__ == "__main__":
    _main()
