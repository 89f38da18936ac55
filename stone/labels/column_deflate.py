"""Deflates a label grid from its columns: each column is compared with the previous one in words, not voxels.

**Conventions.** The grid is a sequence of columns of 8, 16 or 32 bytes, its height (`stone.labels.columns`). A byte
that differs from the previous column is a literal; stretches of equal bytes are matches one column back. The output is
one final block with its own code; all matches have the same distance, whose code takes one bit. Words are filled from
the lowest bit.

Source: RFC 1951, 3.2.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from stone.kernels.lanes import I8, I32, I64, pointer, popcount, splat
from stone.labels.columns import Words, nothing
from stone_base.label_grid import PAPER

# Converts a label grid to literals and matches, from the words of its columns. Equal stretches shorter than `FEWEST`
# are literals. The set bits of a word are unpredictable, so branches on them would be mispredicted at every other byte.
# Therefore columns that differ are gathered first, then their differing bytes, eight at a time; then the tokens are
# written.


FEWEST, MOST = 3, 258  # bytes: length of matches
LITERALS, END, MATCH = 4, 4, 5  # tokens: a literal is its value, a match of n bytes is `MATCH` + n
TOKENS = MATCH + MOST + 1
EIGHT, BEFORE = 8, 2  # bytes compared at once, and bytes before a literal that are stored with it
# The numbers of the set bits in each byte, from the lowest, then zeros.
BITS = np.array([[*(n for n in range(8) if byte >> n & 1), *[0] * 8][:8] for byte in range(256)], np.int32)


def tokens_of(ones: Words, twos: Words, height: int) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
    """Return the tokens of the grid, `END` last, and the number of occurrences of each (`TOKENS`,)."""
    low, high, size = ones.reshape(-1), twos.reshape(-1), height * ones.size
    columns = np.empty(ones.size + 1, np.int64)
    places, codes = np.empty(size + EIGHT, np.int32), np.empty(size + EIGHT, np.uint8)
    differing = columns[: _find_columns(low, high, columns)]
    literals = _find_literals((low, high), differing, (0,) * (height // EIGHT), places, codes)
    tokens, counts = np.empty(size + 2, np.uint16), np.zeros(TOKENS, np.int64)
    last = low[-1] >> np.uint32(height - BEFORE), high[-1] >> np.uint32(height - BEFORE)
    filled = _say((places[:literals], codes), (size, *last), tokens)
    _count(tokens[:filled], counts)
    return tokens[:filled], counts


def _note_eight_of(typing_context: Any, bits: Any, byte: Any, first: Any, near: Any, out: Any, at: Any) -> Any:
    """Write the positions of a byte's set bits to out[0] from `at` on, and their codes to out[1]. The first bit has
    position `first`. A code is three bits of near[0] from the position, then three of near[1]. Always write eight
    values.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits, byte, first, near, out, at = arguments
        lanes, bytes_ = ir.VectorType(I32, EIGHT), ir.VectorType(I8, EIGHT)
        row = builder.mul(byte, ir.Constant(I64, EIGHT))
        bit = builder.load(pointer(context, builder, (signature.args[0], bits), row, lanes, EIGHT), align=4)
        position = builder.add(splat(builder, builder.trunc(first, I32), lanes), bit)
        places, codes = ((signature.args[4][n], builder.extract_value(out, n)) for n in range(2))
        builder.store(position, pointer(context, builder, places, at, lanes, EIGHT), 4)
        three = ir.Constant(lanes, [7] * EIGHT)
        low, high = (
            builder.and_(builder.lshr(splat(builder, builder.extract_value(near, n), lanes), bit), three)
            for n in range(2)
        )
        code = builder.trunc(builder.or_(low, builder.shl(high, ir.Constant(lanes, [3] * EIGHT))), bytes_)
        builder.store(code, pointer(context, builder, codes, at, bytes_, EIGHT), 1)
        return context.get_dummy_value()

    return types.void(bits, types.int64, types.int64, near, out, types.int64), emit


note_eight: Any = intrinsic(_note_eight_of)


@njit(cache=True, nogil=True)
def _find_columns(ones, twos, columns):  # type: ignore[no-untyped-def]
    """Write the first column and those that differ from the previous one; return their number."""
    columns[0], count = 0, 1
    for column in range(1, ones.size):
        columns[count] = column
        count += ((ones[column] ^ ones[column - 1]) | (twos[column] ^ twos[column - 1])) != 0
    return count


@njit(cache=True, nogil=True)
def _find_literals(words, columns, eights, places, codes):  # type: ignore[no-untyped-def]
    """Write the positions of the differing bytes (all of the first column), each with its value and the `BEFORE` bytes
    before it.

    `eights` is a tuple with one element per eight bytes of a column, so that the height is known at compile time.
    """
    (low_plane, high_plane), count, height = words, np.int64(0), EIGHT * len(eights)
    last, whole = np.uint32(height - BEFORE), np.uint32((np.uint64(1) << np.uint64(height)) - np.uint64(1))
    for n in range(columns.size):
        column = columns[n]
        low, high = low_plane[column], high_plane[column]
        one_before, two_before = (low_plane[column - 1], high_plane[column - 1]) if n else (~low & whole, high)
        differs = np.uint64((low ^ one_before) | (high ^ two_before))
        near_one = np.uint64(low) << np.uint64(BEFORE) | np.uint64(one_before >> last)
        near_two = np.uint64(high) << np.uint64(BEFORE) | np.uint64(two_before >> last)
        for byte in range(len(eights)):
            shift = np.uint64(EIGHT * byte)
            at = count + np.int64(popcount(differs & ((np.uint64(1) << shift) - np.uint64(1))))
            near = np.uint32(near_one >> shift), np.uint32(near_two >> shift)
            set_bits = np.int64((differs >> shift) & np.uint64(255))
            note_eight(BITS, set_bits, height * column + EIGHT * byte, near, (places, codes), at)
        count += np.int64(popcount(differs))
    return count


@njit(inline="always")
def _value(code, back):  # type: ignore[no-untyped-def]
    """Return the byte `back` positions before a literal, from its code; the literal itself for 0."""
    return (code >> (BEFORE - back) & 1) | (code >> (BEFORE - back + 3) & 1) << 1


@njit(cache=True, nogil=True)
def _say(literals, end, tokens):  # type: ignore[no-untyped-def]
    """Write the literals and the bytes between them; return the number of tokens.

    `end` is the size of the grid and the last bits of its words.
    """
    (places, codes), (size, low, high) = literals, end
    filled, after = 0, 0
    for n in range(places.size):
        position, code = int(places[n]), int(codes[n])
        same, after = position - after, position + 1
        if same > MOST:
            filled = _put_matches(same, tokens, filled)
            same = 0
        is_few = same < FEWEST
        few = _value(code, 2) if same == 2 else _value(code, 1)
        tokens[filled] = few if is_few else MATCH + same
        tokens[filled + 1] = _value(code, 1)
        filled += same if is_few else 1
        tokens[filled] = _value(code, 0)
        filled += 1
    same = size - after
    if same >= FEWEST:
        filled = _put_matches(same, tokens, filled)
    else:
        for back in range(same, 0, -1):
            tokens[filled] = (low >> np.uint32(BEFORE - back) & 1) | (high >> np.uint32(BEFORE - back) & 1) << 1
            filled += 1
    tokens[filled] = END
    return filled + 1


@njit(cache=True, nogil=True)
def _put_matches(length, tokens, filled):  # type: ignore[no-untyped-def]
    """Write at least `FEWEST` bytes that equal the previous column's."""
    while length > 0:
        piece = min(length, MOST)
        if 0 < length - piece < FEWEST:
            piece = length - FEWEST
        tokens[filled] = MATCH + piece
        filled += 1
        length -= piece
    return filled


@njit(cache=True, nogil=True)
def _count(tokens, counts):  # type: ignore[no-untyped-def]
    for at in range(tokens.size):
        counts[tokens[at]] += 1


LONGEST_CODE, SHARE = 15, 2000  # no symbol counts less than this share, so no code is longer; see `_code_lengths`
END_OF_BLOCK, SYMBOLS = 256, 286
# By height: the symbol of that distance, the number of bits after its code, and the code 0 with those bits above it.
# The bits are all ones, because 8, 16 and 32 are the last distances of their symbols (3.2.5 of the source).
DISTANCES = {8: (5, 1, 0b10), 16: (7, 2, 0b110), 32: (9, 3, 0b1110)}
CODE_LENGTH_ORDER = (16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15)
TURNED = np.array([int(f"{length:04b}"[::-1], 2) for length in range(16)])  # codes start with their highest bit


@lru_cache(maxsize=3)
def _token_symbols(height: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return, per token, its symbol, the number of bits after the symbol's code, and these bits (3.2.5 of the
    source).
    """
    _, distance_bits, distance_word = DISTANCES[height]
    symbols, bits, extra = np.zeros((3, TOKENS), np.int64)
    symbols[:LITERALS], symbols[END] = np.arange(LITERALS), END_OF_BLOCK
    length, symbol = FEWEST, END_OF_BLOCK + 1
    for width in [0] * 8 + [each for each in range(1, 6) for _ in range(4)]:
        for value in range(1 << width):
            symbols[MATCH + length], bits[MATCH + length], extra[MATCH + length] = symbol, width, value
            length += 1
        symbol += 1
    symbols[MATCH + MOST], bits[MATCH + MOST], extra[MATCH + MOST] = symbol, 0, 0
    matches = slice(MATCH + FEWEST, None)
    extra[matches] |= distance_word << bits[matches]
    bits[matches] += 1 + distance_bits
    return symbols, bits, extra


def deflated_columns(ones: Words, twos: Words | None = None, height: int = PAPER.shape[2]) -> bytes:
    """Return the final deflate block of the grid that `stone.labels.columns.spread_out` makes from these columns."""
    tokens, counts = tokens_of(ones, nothing(ones.shape) if twos is None else twos, height)
    symbols = _token_symbols(height)
    lengths = _code_lengths(np.bincount(symbols[0], counts, SYMBOLS).astype(np.int64))
    words, bits = _token_words(lengths, symbols)
    header = _header(lengths, DISTANCES[height][0])
    size = int(header[:, 1].sum()) + int(bits.astype(np.int64) @ counts)
    out = np.empty(size // 32 + 1, "<u4")
    _write(tokens, words, bits, header, out)
    return out.tobytes()[: (size + 7) // 8]


def _header(lengths: NDArray[np.int64], distance: int) -> NDArray[np.uint64]:
    """Return values and widths (K, 2) of the fields at the start of a block with its own code (3.2.7).

    Code lengths are written as four-bit values; `distance` is the last distance symbol, and the only one used.
    """
    fixed = [(1, 1), (2, 2), (SYMBOLS - 257, 5), (distance, 5), (len(CODE_LENGTH_ORDER) - 4, 4)]
    fixed += [(4 if length <= LONGEST_CODE else 0, 3) for length in CODE_LENGTH_ORDER]
    coded = np.full((SYMBOLS + distance + 1, 2), 4, np.uint64)
    coded[:, 0] = TURNED[np.append(lengths, np.arange(distance + 1) == distance)]
    return np.concatenate([np.array(fixed, np.uint64), coded])


@njit(cache=True, nogil=True)
def _code_lengths(counts):  # type: ignore[no-untyped-def]
    """Return the code length of each used symbol (at least two) by Huffman's algorithm; 0 for unused symbols.

    A tree of depth `LONGEST_CODE` + 1 weighs at least 2584 times its lightest leaf, a Fibonacci number. With a minimum
    share of 1/2000 of the total and few symbols, no tree is that deep.
    """
    weights, parents = np.zeros(2 * counts.size, np.int64), np.full(2 * counts.size, -1, np.int64)
    least, made, left = counts.sum() // SHARE + 1, counts.size, 0
    for symbol in range(counts.size):
        weights[symbol] = max(counts[symbol], least) if counts[symbol] else 0
        left += counts[symbol] > 0
    while left > 1:
        for _ in range(2):
            lightest = -1
            for node in range(made):
                is_free = weights[node] > 0 and parents[node] < 0
                if is_free and (lightest < 0 or weights[node] < weights[lightest]):
                    lightest = node
            parents[lightest] = made
            weights[made] += weights[lightest]
        made, left = made + 1, left - 1
    lengths = np.zeros(counts.size, np.int64)
    for symbol in range(counts.size):
        node = symbol
        while parents[node] >= 0:
            node = parents[node]
            lengths[symbol] += 1
    return lengths


@njit(cache=True, nogil=True)
def _reversed(code, length):  # type: ignore[no-untyped-def]
    turned = 0
    for _ in range(length):
        turned, code = turned << 1 | code & 1, code >> 1
    return turned


@njit(cache=True, nogil=True)
def _token_words(lengths, symbols):  # type: ignore[no-untyped-def]
    """Return, per token, its bits and their number; codes are canonical (3.2.2)."""
    codes, code = np.zeros(lengths.size, np.int64), 0
    for length in range(1, LONGEST_CODE + 1):
        for symbol in range(lengths.size):
            if lengths[symbol] == length:
                codes[symbol] = _reversed(code, length)
                code += 1
        code <<= 1
    words, bits = np.zeros(TOKENS, np.uint64), np.zeros(TOKENS, np.uint64)
    for token in range(TOKENS):
        length = lengths[symbols[0][token]]
        words[token] = codes[symbols[0][token]] | symbols[2][token] << length
        bits[token] = length + symbols[1][token] if length else 0
    return words, bits


@njit(inline="always")
def _put(out, full, pending, count, word, bits):  # type: ignore[no-untyped-def]
    """Append up to 32 bits to `out` without a branch; return the number of full words, the pending bits and their
    number.
    """
    pending |= word << count
    out[full] = np.uint32(pending & np.uint64(0xFFFFFFFF))
    count += bits
    ready = count >> np.uint64(5)
    return full + np.int64(ready), pending >> (ready << np.uint64(5)), count & np.uint64(31)


@njit(cache=True, nogil=True)
def _write(tokens, words, bits, header, out):  # type: ignore[no-untyped-def]
    """Write the header fields, (K, 2) values and widths, and the tokens."""
    full, pending, count = 0, np.uint64(0), np.uint64(0)
    for field in range(header.shape[0]):
        full, pending, count = _put(out, full, pending, count, header[field, 0], header[field, 1])
    for at in range(tokens.size):
        token = tokens[at]
        full, pending, count = _put(out, full, pending, count, words[token], bits[token])
    out[full] = np.uint32(pending)
