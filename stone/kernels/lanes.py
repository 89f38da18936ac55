"""Single steps on machine words that LLVM fits to the vector unit at hand; to be called from compiled kernels only.

**Conventions.** Bit n of a word stands for lane n: for voxel n of an upright column, or for frame n of a batch.
Addresses are counted in elements of a C-contiguous array. Like those that numba makes itself they are checked with
`NUMBA_BOUNDSCHECK=1` alone: why each is in range is in docs/security/kernels.md.
"""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import config, types
from numba.core.cgutils import do_boundscheck
from numba.extending import intrinsic

BIT, I8, I32, I64 = (ir.IntType(bits) for bits in (1, 8, 32, 64))
COLUMN = 32


def _popcount(typing_context: Any, word: Any) -> Any:
    """How many bits of a uint64 are set."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), emit


def _lowest(typing_context: Any, word: Any) -> Any:
    """The number of the lowest set bit of a uint32 that is not 0."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.zext(builder.cttz(arguments[0], ir.Constant(BIT, 1)), I64)

    return types.int64(types.uint32), emit


def _spread(typing_context: Any, ones: Any, twos: Any, out: Any, at: Any) -> Any:
    """Write 32 bytes from out[at] on: byte n is bit n of `ones` plus twice that of `twos`."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = ir.VectorType(I8, COLUMN)
        low, high = (builder.zext(builder.bitcast(word, bits_of(COLUMN)), lanes) for word in arguments[:2])
        target = pointer(context, builder, (signature.args[2], arguments[2]), arguments[3], lanes, COLUMN)
        builder.store(builder.add(low, builder.add(high, high)), target, 1)
        return context.get_dummy_value()

    return types.void(types.uint32, types.uint32, out, types.int64), emit


def _differs(typing_context: Any, fraction: Any, back: Any, slope: Any, bits: Any) -> Any:
    """Bit n: p = fraction + n · slope and p − back have different floors when divided by 2^bits; all int32."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = ir.VectorType(I32, COLUMN)
        fraction, back, slope, bits = (splat(builder, value, lanes) for value in arguments)
        here = builder.add(fraction, builder.mul(slope, ir.Constant(lanes, list(range(COLUMN)))))
        ends = (builder.ashr(end, bits) for end in (here, builder.sub(here, back)))
        return builder.bitcast(builder.icmp_signed("!=", *ends), I32)

    return types.uint32(types.int32, types.int32, types.int32, types.int32), emit


def _fetch(typing_context: Any, source: Any, at: Any, shift: Any, mask: Any, out: Any, to: Any) -> Any:
    """out[to + p] |= mask & the 32 bits from bit `shift` (below 32) of source[at + p] on, whose next word is
    source[at + 4 + p]; for p of 0 to 3; all uint32."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, at, shift, mask, out, to = arguments
        lanes = ir.VectorType(I32, 4)
        origin = pointer(context, builder, (signature.args[0], source), at, lanes, 8)
        lower = builder.load(origin, align=4)
        upper = builder.load(builder.gep(origin, [ir.Constant(I64, 1)]), align=4)
        right = splat(builder, shift, lanes)
        left = builder.sub(ir.Constant(lanes, [31] * 4), right)  # one less, for a shift by all 32 would be undefined
        upper = builder.shl(builder.shl(upper, ir.Constant(lanes, [1] * 4)), left)
        found = builder.and_(builder.or_(builder.lshr(lower, right), upper), splat(builder, mask, lanes))
        target = pointer(context, builder, (signature.args[4], out), to, lanes, 4)
        builder.store(builder.or_(builder.load(target, align=4), found), target, 4)
        return context.get_dummy_value()

    return types.void(source, types.int64, types.uint32, types.uint32, out, types.int64), emit


def _transpose(typing_context: Any, source: Any, at: Any, out: Any, to: Any) -> Any:
    """Bit m of out[to + n] = bit n of source[at + m], for m and n of 0 to 31."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, at, out, to = arguments
        lanes = ir.VectorType(I32, COLUMN)
        rows = builder.load(pointer(context, builder, (signature.args[0], source), at, lanes, COLUMN), align=4)
        for n in range(COLUMN):
            tested = builder.and_(rows, ir.Constant(lanes, [1 << n] * COLUMN))
            word = builder.bitcast(builder.icmp_unsigned("!=", tested, ir.Constant(lanes, [0] * COLUMN)), I32)
            place = builder.add(to, ir.Constant(I64, n))
            builder.store(word, pointer(context, builder, (signature.args[2], out), place, I32, 1), 4)
        return context.get_dummy_value()

    return types.void(source, types.int64, out, types.int64), emit


def splat(builder: Any, value: Any, lanes: Any) -> Any:
    """The vector that holds this value in every lane."""
    single = builder.insert_element(ir.Constant(lanes, ir.Undefined), value, ir.Constant(I32, 0))
    order = ir.Constant(ir.VectorType(I32, lanes.count), [0] * lanes.count)
    return builder.shuffle_vector(single, ir.Constant(lanes, ir.Undefined), order)


def bits_of(count: int) -> Any:
    return ir.VectorType(BIT, count)


def pointer(context: Any, builder: Any, array: tuple[Any, Any], at: Any, lanes: Any, count: int) -> Any:
    """The address of array[at] as one of `lanes`; of the array `count` elements are read or written from there on."""
    made = context.make_array(array[0])(context, builder, array[1])
    if config.BOUNDSCHECK and count:  # type: ignore[attr-defined]
        for place in (at, builder.add(at, ir.Constant(I64, count - 1))):
            do_boundscheck(context, builder, place, made.nitems)  # type: ignore[no-untyped-call]
    return builder.bitcast(builder.gep(made.data, [at]), lanes.as_pointer())


popcount: Any = intrinsic(_popcount)
lowest: Any = intrinsic(_lowest)
spread: Any = intrinsic(_spread)
differs: Any = intrinsic(_differs)
fetch: Any = intrinsic(_fetch)
transpose: Any = intrinsic(_transpose)


def _prefetch(typing_context: Any, source: Any, at: Any) -> Any:
    """Bring the cache line of source[at] near; harmless anywhere."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = pointer(context, builder, (signature.args[0], arguments[0]), arguments[1], I8, 0)
        kind = ir.FunctionType(ir.VoidType(), [I8.as_pointer(), I32, I32, I32])
        function = builder.module.declare_intrinsic("llvm.prefetch", [I8.as_pointer()], kind)
        builder.call(function, [address, ir.Constant(I32, 0), ir.Constant(I32, 3), ir.Constant(I32, 1)])
        return context.get_dummy_value()

    return types.void(source, types.int64), emit


prefetch: Any = intrinsic(_prefetch)
