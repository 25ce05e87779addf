"""Write the LLVM code of a part of a kernel with fewer instructions: each of them costs time in numba and again in LLVM.

A kernel is a compiled function that Python calls; its parts are functions that only compiled code calls. numba writes for the
general case: a variable lives in memory, a call can fail in many ways, a loop may have any step. LLVM removes what is not needed,
so the machine code is the same. A part has no reference counts, generators or `try`, and its variables are assigned once each after
numba's SSA pass.

Like pipeline.py, this module uses undocumented interfaces of numba.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir as llvm
from numba.core import types
from numba.core.analysis import compute_cfg_from_blocks, compute_use_defs, must_use_alloca
from numba.core.callconv import RETCODE_OK, CPUCallConv, Status
from numba.core.compiler_machinery import register_pass
from numba.core.cpu import CPUContext
from numba.core.datamodel.models import TupleModel, UniTupleModel
from numba.core.datamodel.registry import default_manager
from numba.core.ir import Assign, Expr
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering


class Whole:
    """Base of numba data models that pass a NamedTuple to a function as one LLVM argument, so that kernels compile faster.

    numba would pass each number separately.
    """

    def get_argument_type(self) -> Any:
        return self.get_value_type()  # pyright: ignore[reportAttributeAccessIssue]

    def as_argument(self, builder: Any, value: Any) -> Any:
        return value

    def from_argument(self, builder: Any, value: Any) -> Any:
        return value


def record_model(general: type) -> Any:
    """Return a function that makes numba's data model of a NamedTuple class: `general`, with `Whole` for our own classes."""
    package = __name__.partition(".")[0]
    own: Any = type("RecordModel", (Whole, general), {})
    return lambda manager, kind: (
        own if kind.instance_class.__module__.partition(".")[0] == package else general
    )(manager, kind)  # fmt: skip


default_manager.register(types.NamedTuple, record_model(TupleModel))
default_manager.register(types.NamedUniTuple, record_model(UniTupleModel))


class PartConvention(CPUCallConv):
    """Calling convention for functions that only compiled code calls, with less LLVM code for each call than numba's own.

    A function that fails stores its exception where the kernel's Python wrapper finds it.
    """

    def call_function(
        self, builder: Any, callee: Any, resty: Any, argtys: Sequence, args: Sequence, attrs: Any = None
    ) -> tuple[Status, Any]:
        """Write the LLVM code of a call, which hands on the place for an exception; return the LLVM values of status and result."""
        if isinstance(resty, types.Optional):
            return super().call_function(builder, callee, resty, argtys, args, attrs)
        place = self._get_return_argument(callee.function_type).pointee
        with builder.goto_entry_block():
            slot = builder.alloca(place)
        packed = self._get_arg_packer(argtys).as_arguments(builder, args)
        code = builder.call(callee, [slot, self._get_excinfo_argument(builder.function), *packed], attrs=attrs or ())
        failed = builder.icmp_signed("!=", code, RETCODE_OK)
        status = Status(code, *[None] * len(Status._fields[1:]))._replace(is_error=failed)
        return status, self.context.get_returned_value(builder, resty, builder.load(slot))

    def return_status_propagate(self, builder: Any, status: Status) -> None:
        """Write LLVM code by which a function returns the error code of a failed call to its own caller."""
        if status.excinfoptr is not None:
            builder.store(status.excinfoptr, self._get_excinfo_argument(builder.function))
        self._return_errcode_raw(builder, status.code)


class PartContext(CPUContext):
    """numba's target context (what it knows of the processor), changed so that calls follow PartConvention."""

    call_conv = property(PartConvention)


class PartLower(Lower):
    """Translates the typed intermediate code of numba to LLVM code, for functions that only compiled code calls."""

    def _find_singly_assigned_variable(self) -> None:
        """Find the variables that need no memory: those assigned once, in a block that is passed before each use.

        numba keeps in memory every variable that is used in more than one block.
        """
        blocks = self.func_ir.blocks
        graph, used = compute_cfg_from_blocks(blocks), compute_use_defs(blocks).usemap
        homes: dict[str, list] = {}
        for label, block in blocks.items():
            for step in block.find_insts(Assign):
                homes.setdefault(step.target.name, []).append(label)
        before = graph.dominators()
        free = {name for name, found in homes.items() if len(found) == 1} - must_use_alloca(blocks)
        for label, names in used.items():
            # LLVM code is written block by block in the order of their labels, so a variable must be set in a block written
            # earlier.
            free -= {name for name in names & free if homes[name][0] >= label or homes[name][0] not in before[label]}
        self._singly_assigned_vars, self._blk_local_varmap = free, {}

    def storevar(self, value: Any, name: str, argidx: Any = None) -> None:
        """Assign an LLVM value to a variable: in a register if the variable is assigned only once, else in memory.

        Numba's own method also counts references to the old value, which the arrays and numbers of kernels do not need.
        """
        if name in self._singly_assigned_vars:
            self._blk_local_varmap[name] = value
        else:
            self.builder.store(value, self.getvar(name))

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        """Write the LLVM code of an expression.

        For a `range` with step 1, the division by which numba finds its length is left out.
        """
        if expr.op in ("getiter", "iternext"):
            kind = self.typeof(expr.value.name)
            value = self.loadvar(expr.value.name)
            if isinstance(kind, types.RangeType) and self._counts_by_one(expr.value):
                return self._begin_range(resty, value)
            if isinstance(kind, types.RangeIteratorType):
                return self._next_of_range(resty, value)
        return super().lower_expr(resty, expr)

    def _counts_by_one(self, name: Any) -> bool:
        made = self.func_ir.get_definition(name)
        return isinstance(made, Expr) and made.op == "call" and len(made.args) < 3

    def _begin_range(self, kind: Any, value: Any) -> Any:
        builder = self.builder
        start, stop, step = (builder.extract_value(value, k) for k in range(3))
        with builder.goto_entry_block():
            place, left = builder.alloca(start.type), builder.alloca(start.type)
        length, zero = builder.sub(stop, start), llvm.Constant(start.type, 0)
        builder.store(start, place)
        builder.store(builder.select(builder.icmp_signed(">", length, zero), length, zero), left)
        made = llvm.Constant(self.context.get_value_type(kind), llvm.Undefined)
        for k, part in enumerate((place, stop, step, left)):  # the order of the fields of RangeIter in numba
            made = builder.insert_value(made, part, k)
        return made

    def _next_of_range(self, kind: Any, value: Any) -> Any:
        builder = self.builder
        place, step, left = (builder.extract_value(value, k) for k in (0, 2, 3))
        now, count = builder.load(place), builder.load(left)
        fewer = builder.sub(count, llvm.Constant(count.type, 1), flags=["nsw"])  # pyright: ignore[reportCallIssue]
        builder.store(fewer, left)
        builder.store(builder.add(now, step), place)
        more = builder.icmp_signed(">", count, llvm.Constant(count.type, 0))
        pair = llvm.Constant(self.context.get_value_type(kind), llvm.Undefined)
        return builder.insert_value(builder.insert_value(pair, now, 0), more, 1)


@register_pass(mutates_CFG=True, analysis_only=False)
class PartLowering(NativeLowering):
    """The compiler pass of numba that writes LLVM code, here by PartLower, for functions that only compiled code calls."""

    _name = "part_lowering"
    lowering_class = property(lambda self: PartLower)
