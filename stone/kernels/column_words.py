"""Single steps on upright voxel columns, compiled to a few vector instructions; for use in compiled kernels only.

**Conventions.** A column is 32 voxels: 32 bytes of labels, or one uint32 of a plane, where bit n is voxel n. Addresses
count elements of a C-contiguous array, and are checked like those of `stone.kernels.lanes`.
"""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from stone.kernels.lanes import COLUMN, I8, I32, I64, pointer, splat

VECTOR = 64  # bytes tested at a time
LOW, HIGH, BEYOND = 1, 2, 0xFC


def _pack8(typing_context: Any, voxels: Any, start: Any, low: Any, high: Any, at: Any) -> Any:
    """Write bits 0 and 1 of the 256 bytes from voxels[start] to low[at] and high[at]; return not 0 if any value is
    above 3.
    """
    return _packing(voxels, low, high, 8)


def _pack1(typing_context: Any, voxels: Any, start: Any, low: Any, high: Any, at: Any) -> Any:
    """Do the same as `pack8` for 32 bytes."""
    return _packing(voxels, low, high, 1)


def _packing(voxels: Any, low: Any, high: Any, columns: int) -> Any:
    size = min(VECTOR, columns * COLUMN)
    lanes, word = ir.VectorType(I8, size), ir.IntType(size)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def bits(bytes_: Any, mask: int) -> Any:
            tested = builder.and_(bytes_, ir.Constant(lanes, [mask] * size))
            return builder.bitcast(builder.icmp_unsigned("!=", tested, ir.Constant(lanes, [0] * size)), word)

        source = pointer(context, builder, (voxels, arguments[0]), arguments[1], lanes, columns * COLUMN)
        both = ((low, arguments[2]), (high, arguments[3]))
        planes = [pointer(context, builder, plane, arguments[4], word, columns) for plane in both]
        seen = ir.Constant(lanes, [0] * size)
        for n in range(columns * COLUMN // size):
            offset = ir.Constant(I64, n)
            loaded = builder.load(builder.gep(source, [offset]), align=1)
            seen = builder.or_(seen, loaded)
            for plane, mask in zip(planes, (LOW, HIGH), strict=True):
                builder.store(bits(loaded, mask), builder.gep(plane, [offset]), 4)
        return builder.zext(bits(seen, BEYOND), I64) if size < VECTOR else bits(seen, BEYOND)

    return types.uint64(voxels, types.int64, low, high, types.int64), emit


def _drivable32(typing_context: Any, low: Any, high: Any, evaluated: Any, at: Any) -> Any:
    """Return a word: bit n is set if column at + n has an evaluated voxel of class 1 or 2 and none of class 3."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = ir.VectorType(I32, 32)
        none = ir.Constant(lanes, [0] * 32)
        columns = [
            builder.load(pointer(context, builder, (kind, array), arguments[3], lanes, 32), align=4)
            for kind, array in zip(signature.args[:3], arguments[:3], strict=True)
        ]
        low_plane, high_plane = (builder.and_(plane, columns[2]) for plane in columns[:2])
        has_any = builder.icmp_unsigned("!=", builder.or_(low_plane, high_plane), none)
        has_no_three = builder.icmp_unsigned("==", builder.and_(low_plane, high_plane), none)
        return builder.bitcast(builder.and_(has_any, has_no_three), I32)

    return types.uint32(low, high, evaluated, types.int64), emit


def _unroll8(typing_context: Any, changes: Any, runs: Any, run: Any, out: Any, at: Any) -> Any:
    """Write out[at + n] = runs[run + number of set bits among the lowest n + 1 of `changes`], for n from 0 to 7.

    Always reads eight entries of `runs` from run + (changes & 1). Return the number of set bits among the 8.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        changes, runs, run, out, at = arguments
        lanes = ir.VectorType(I32, 8)
        lowest = ir.Constant(lanes, [(2 << n) - 1 for n in range(8)])
        counts = _called(builder, "llvm.ctpop.v8i32", lanes, builder.and_(splat(builder, changes, lanes), lowest))
        first = builder.and_(changes, ir.Constant(I32, 1))
        rank = builder.sub(counts, splat(builder, first, lanes))
        source = builder.add(run, builder.zext(first, I64))
        near = builder.load(pointer(context, builder, (signature.args[1], runs), source, lanes, 8), align=4)
        permuted = _permuted(context, builder, near, rank)
        builder.store(permuted, pointer(context, builder, (signature.args[3], out), at, lanes, 8), 4)
        return builder.zext(builder.extract_element(counts, ir.Constant(I32, 7)), I64)

    return types.int64(types.uint32, runs, types.int64, out, types.int64), emit


def _permuted(context: Any, builder: Any, near: Any, rank: Any) -> Any:
    """Return a vector: lane n is lane rank[n] of `near`, with one AVX2 instruction or lane by lane."""
    lanes = near.type
    if "+avx2" in str(context.codegen().magic_tuple()[2]):
        return _called(builder, "llvm.x86.avx2.permd", lanes, near, rank)
    permuted = ir.Constant(lanes, ir.Undefined)
    for n in range(lanes.count):
        index = ir.Constant(I32, n)
        lane = builder.extract_element(near, builder.extract_element(rank, index))
        permuted = builder.insert_element(permuted, lane, index)
    return permuted


def _called(builder: Any, name: str, kind: Any, *values: Any) -> Any:
    """Return the call of the intrinsic `name` with argument and result type `kind`."""
    known = builder.module.globals.get(name)
    function = known or ir.Function(builder.module, ir.FunctionType(kind, [kind] * len(values)), name)
    return builder.call(function, values)


pack8: Any = intrinsic(_pack8)
pack1: Any = intrinsic(_pack1)
drivable32: Any = intrinsic(_drivable32)
unroll8: Any = intrinsic(_unroll8)
