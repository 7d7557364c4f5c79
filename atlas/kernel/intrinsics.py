"""Instructions of LLVM that kernels use and Numba does not offer."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj

VECTOR_BITS = 512  # length of the longest vectors of any processor


@intrinsic
def full_vectors(typingctx):
    """Let the calling kernel use the processor's longest vectors, and align the stack of the kernel to 64 bytes.

    On Intel's processors LLVM by default uses half of the length of AVX-512, so that rk8 needs 1.8 times as long. LLVM aligns
    spilled vectors only if another object on the stack is aligned. A vector across two cache lines costs up to a fifth of the time.
    """

    def generate(context, builder, signature, arguments):
        with builder.goto_entry_block():
            line = builder.alloca(ir.ArrayType(ir.DoubleType(), 8))
            line.align = 64
        builder.asm(ir.FunctionType(ir.VoidType(), [line.type]), "", "r", [line], side_effect=True)
        # `add` of llvmlite refuses an attribute with a value.
        set.add(builder.function.attributes, f'"prefer-vector-width"="{VECTOR_BITS}"')
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic
def aligned_empty(typingctx, shape):
    """Return np.empty(shape) aligned to 64 bytes. Numba aligns to 32 bytes, with which kernels are up to a fifth slower."""

    def generate(context, builder, signature, arguments):
        lengths = cgutils.unpack_tuple(builder, arguments[0])
        aligned = context.subtarget(get_preferred_array_alignment=lambda dtype: 64)
        return arrayobj._empty_nd_impl(aligned, builder, signature.return_type, lengths)._getvalue()

    return types.Array(types.float64, len(shape), "C")(shape), generate


@intrinsic
def axpy(typingctx, y, weights, slopes):
    """Return the tuple y plus a weighted sum of tuples. Numba handles this as one instruction, not a thousand operations."""

    def generate(context, builder, signature, arguments):
        operands = [
            list(zip(cgutils.unpack_tuple(builder, value), kind, strict=True))
            for value, kind in zip(arguments, signature.args, strict=True)
        ]

        def component(vector, kind, i):
            return context.cast(builder, builder.extract_value(vector, i), kind[i], types.float64)

        row = []
        for i, (value, kind) in enumerate(operands[0]):
            total = None
            for (weight, _), (slope, slope_kind) in zip(operands[1], operands[2], strict=True):
                product = builder.fmul(weight, component(slope, slope_kind, i))
                total = product if total is None else builder.fadd(total, product)
            row.append(builder.fadd(context.cast(builder, value, kind, types.float64), total))
        return context.make_tuple(builder, signature.return_type, row)

    return types.UniTuple(types.float64, len(y))(y, weights, slopes), generate
