"""Single steps on machine words that LLVM fits to the available vector unit; for use in compiled kernels only.

**Conventions.** Bit n of a word is lane n: voxel n of an upright column, or frame n of a batch. Addresses count
elements of a C-contiguous array. As in numba's own code, they are checked only with `NUMBA_BOUNDSCHECK=1`:
docs/developers/kernels.md explains why each is in range.
"""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import config, types
from numba.core.cgutils import do_boundscheck
from numba.extending import intrinsic

BIT, I8, I32, I64 = (ir.IntType(bits) for bits in (1, 8, 32, 64))
COLUMN = 32


def _popcount(typing_context: Any, word: Any) -> Any:
    """Return the number of set bits of a uint64."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), emit


def _lowest(typing_context: Any, word: Any) -> Any:
    """Return the number of the lowest set bit of a uint32 that is not 0."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.zext(builder.cttz(arguments[0], ir.Constant(BIT, 1)), I64)

    return types.int64(types.uint32), emit


def _spread(typing_context: Any, ones: Any, twos: Any, out: Any, at: Any) -> Any:
    """Write 32 bytes from out[at]: byte n is bit n of `ones` plus twice bit n of `twos`."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = ir.VectorType(I8, COLUMN)
        low, high = (builder.zext(builder.bitcast(word, bits_of(COLUMN)), lanes) for word in arguments[:2])
        target = pointer(context, builder, (signature.args[2], arguments[2]), arguments[3], lanes, COLUMN)
        builder.store(builder.add(low, builder.add(high, high)), target, 1)
        return context.get_dummy_value()

    return types.void(types.uint32, types.uint32, out, types.int64), emit


def _differs(typing_context: Any, fraction: Any, back: Any, slope: Any, bits: Any) -> Any:
    """Return a word: bit n is set if p = fraction + n · slope and p − back have different floors after division by
    2^bits.

    All arguments are int32.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = ir.VectorType(I32, COLUMN)
        fraction, back, slope, bits = (splat(builder, value, lanes) for value in arguments)
        here = builder.add(fraction, builder.mul(slope, ir.Constant(lanes, list(range(COLUMN)))))
        ends = (builder.ashr(end, bits) for end in (here, builder.sub(here, back)))
        return builder.bitcast(builder.icmp_signed("!=", *ends), I32)

    return types.uint32(types.int32, types.int32, types.int32, types.int32), emit


def _looked_up(typing_context: Any, block: Any, last: Any, place: Any, slope: Any, bits: Any) -> Any:
    """Return four words of a column: bit n of word p is bit p of the block's byte at position place + n · slope.

    Each of the three coordinates, divided by 2^bits, is a layer of the block, clamped to 0 … `last`. The block is flat,
    its last axis runs fastest, and it has less than 2^31 bytes. All arguments are int64; 32 bits of `slope` suffice.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        block, *axes, bits = arguments
        at = _offsets(builder, axes, bits)
        lanes, gathered = ir.VectorType(I8, COLUMN), ir.Constant(ir.VectorType(I8, COLUMN), ir.Undefined)
        for n in range(COLUMN):  # one by one: vector gathers take a third longer
            address = builder.zext(builder.extract_element(at, ir.Constant(I32, n)), I64)
            byte = builder.load(pointer(context, builder, (signature.args[0], block), address, I8, 1))
            gathered = builder.insert_element(gathered, byte, ir.Constant(I32, n))
        words = []
        for bit in range(4):
            tested = builder.and_(gathered, ir.Constant(lanes, [1 << bit] * COLUMN))
            words.append(builder.bitcast(builder.icmp_unsigned("!=", tested, ir.Constant(lanes, [0] * COLUMN)), I32))
        return context.make_tuple(builder, signature.return_type, words)

    three, four = (types.UniTuple(kind, count) for kind, count in ((types.int64, 3), (types.uint32, 4)))  # type: ignore[no-untyped-call]
    return four(block, three, three, three, types.int64), emit


def _offsets(builder: Any, axes: Any, bits: Any) -> Any:
    """Return the offsets of `_looked_up` in its block, 32 values of 32 bits; `axes` are last, place and slope."""
    lanes = ir.VectorType(I32, COLUMN)
    numbers, none = ir.Constant(lanes, list(range(COLUMN))), ir.Constant(lanes, [0] * COLUMN)
    offsets = none
    for axis in range(3):
        last, position, slope = (builder.extract_value(each, axis) for each in axes)
        whole = builder.ashr(position, bits)
        part, last, whole, slope = (
            splat(builder, builder.trunc(value, I32), lanes)
            for value in (builder.sub(position, builder.shl(whole, bits)), last, whole, slope)
        )
        part = builder.add(part, builder.mul(slope, numbers))
        layer = builder.add(whole, builder.ashr(part, splat(builder, builder.trunc(bits, I32), lanes)))
        layer = builder.select(builder.icmp_signed("<", layer, none), none, layer)
        layer = builder.select(builder.icmp_signed(">", layer, last), last, layer)
        offsets = builder.add(builder.mul(offsets, builder.add(last, ir.Constant(lanes, [1] * COLUMN))), layer)
    return offsets


def _transpose(typing_context: Any, source: Any, at: Any, out: Any, to: Any) -> Any:
    """Transpose: bit m of out[to + n] = bit n of source[at + m], for m and n from 0 to 31."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, at, out, to = arguments
        lanes = ir.VectorType(I32, COLUMN)
        rows = builder.load(pointer(context, builder, (signature.args[0], source), at, lanes, COLUMN), align=4)
        for n in range(COLUMN):
            tested = builder.and_(rows, ir.Constant(lanes, [1 << n] * COLUMN))
            word = builder.bitcast(builder.icmp_unsigned("!=", tested, ir.Constant(lanes, [0] * COLUMN)), I32)
            row = builder.add(to, ir.Constant(I64, n))
            builder.store(word, pointer(context, builder, (signature.args[2], out), row, I32, 1), 4)
        return context.get_dummy_value()

    return types.void(source, types.int64, out, types.int64), emit


def splat(builder: Any, value: Any, lanes: Any) -> Any:
    """Return the vector with this value in every lane."""
    single = builder.insert_element(ir.Constant(lanes, ir.Undefined), value, ir.Constant(I32, 0))
    order = ir.Constant(ir.VectorType(I32, lanes.count), [0] * lanes.count)
    return builder.shuffle_vector(single, ir.Constant(lanes, ir.Undefined), order)


def bits_of(count: int) -> Any:
    return ir.VectorType(BIT, count)


def pointer(context: Any, builder: Any, array: tuple[Any, Any], at: Any, lanes: Any, count: int) -> Any:
    """Return the address of array[at] as a vector of `lanes`; the kernel accesses `count` elements from there."""
    made = context.make_array(array[0])(context, builder, array[1])
    if config.BOUNDSCHECK and count:  # type: ignore[attr-defined]
        for address in (at, builder.add(at, ir.Constant(I64, count - 1))):
            do_boundscheck(context, builder, address, made.nitems)  # type: ignore[no-untyped-call]
    return builder.bitcast(builder.gep(made.data, [at]), lanes.as_pointer())


popcount: Any = intrinsic(_popcount)
lowest: Any = intrinsic(_lowest)
spread: Any = intrinsic(_spread)
differs: Any = intrinsic(_differs)
looked_up: Any = intrinsic(_looked_up)
transpose: Any = intrinsic(_transpose)


def _prefetch(typing_context: Any, source: Any, at: Any) -> Any:
    """Prefetch the cache line of source[at]; any address is safe."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = pointer(context, builder, (signature.args[0], arguments[0]), arguments[1], I8, 0)
        kind = ir.FunctionType(ir.VoidType(), [I8.as_pointer(), I32, I32, I32])
        function = builder.module.declare_intrinsic("llvm.prefetch", [I8.as_pointer()], kind)
        builder.call(function, [address, ir.Constant(I32, 0), ir.Constant(I32, 3), ir.Constant(I32, 1)])
        return context.get_dummy_value()

    return types.void(source, types.int64), emit


prefetch: Any = intrinsic(_prefetch)
