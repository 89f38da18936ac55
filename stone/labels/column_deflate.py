"""Deflates a label grid from its columns: what a column shares with the one before is compared in words, not voxels.

**Conventions.** The grid is a run of columns of 32 bytes (`stone.labels.columns`). A byte that differs from that of the
column before is a literal, stretches of others are matches `BACK` bytes back. All is one final block with a code of its
own; as matches have one distance alone, its code takes a bit. Words are filled from their lowest bit on.

Source: RFC 1951, 3.2.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.labels.column_tokens import END, FEWEST, LITERALS, MATCH, MOST, TOKENS, tokens_of
from stone.labels.columns import NOTHING, Words

LONGEST_CODE, SHARE = 15, 2000  # no symbol counts for less than this share: so no code is longer, see `_code_lengths`
END_OF_BLOCK, SYMBOLS, DISTANCES, DISTANCE_SYMBOL = 256, 286, 10, 9
DISTANCE_BITS, DISTANCE_WORD = 4, 0b1110  # the code, 0, and the 7 by which `BACK` is beyond 25, the symbol's least
CODE_LENGTH_ORDER = (16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15)
TURNED = np.array([int(f"{length:04b}"[::-1], 2) for length in range(16)])  # codes begin with their highest bit


def _token_symbols() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Per token its symbol, the number of bits after the symbol's code, and these bits; 3.2.5 of the source."""
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
    extra[matches] |= DISTANCE_WORD << bits[matches]
    bits[matches] += DISTANCE_BITS
    return symbols, bits, extra


TOKEN_SYMBOLS, TOKEN_BITS, TOKEN_EXTRA = _token_symbols()


def deflated_columns(ones: Words, twos: Words = NOTHING) -> bytes:
    """The final deflate block of the grid that `stone.labels.columns.spread_out` makes of these columns."""
    tokens, counts = tokens_of(ones, twos)
    lengths = _code_lengths(np.bincount(TOKEN_SYMBOLS, counts, SYMBOLS).astype(np.int64))
    words, bits = _token_words(lengths)
    header = _header(lengths)
    size = int(header[:, 1].sum()) + int(bits.astype(np.int64) @ counts)
    out = np.empty(size // 32 + 1, "<u4")
    _write(tokens, words, bits, header, out)
    return out.tobytes()[: (size + 7) // 8]


def _header(lengths: NDArray[np.int64]) -> NDArray[np.uint64]:
    """The values and widths (K, 2) of the fields that begin a block with a code of its own (3.2.7).

    The lengths of codes are written in a code of four bits each, their value itself.
    """
    fixed = [(1, 1), (2, 2), (SYMBOLS - 257, 5), (DISTANCES - 1, 5), (len(CODE_LENGTH_ORDER) - 4, 4)]
    fixed += [(4 if length <= LONGEST_CODE else 0, 3) for length in CODE_LENGTH_ORDER]
    coded = np.full((SYMBOLS + DISTANCES, 2), 4, np.uint64)
    coded[:, 0] = TURNED[np.append(lengths, np.arange(DISTANCES) == DISTANCE_SYMBOL)]
    return np.concatenate([np.array(fixed, np.uint64), coded])


@njit(cache=True, nogil=True)
def _code_lengths(counts):  # type: ignore[no-untyped-def]
    """The bits of the code of each symbol that comes, by Huffman's algorithm: 0 of others; two come at least.

    A tree `LONGEST_CODE` + 1 deep weighs 2584 times its lightest leaf, a Fibonacci number, or more; a share of a 2000th
    of what is counted and the few symbols there are leave none that deep.
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
def _token_words(lengths):  # type: ignore[no-untyped-def]
    """Per token the bits that stand for it and how many they are; codes are canonical (3.2.2)."""
    codes, code = np.zeros(lengths.size, np.int64), 0
    for length in range(1, LONGEST_CODE + 1):
        for symbol in range(lengths.size):
            if lengths[symbol] == length:
                codes[symbol] = _reversed(code, length)
                code += 1
        code <<= 1
    words, bits = np.zeros(TOKENS, np.uint64), np.zeros(TOKENS, np.uint64)
    for token in range(TOKENS):
        length = lengths[TOKEN_SYMBOLS[token]]
        words[token] = codes[TOKEN_SYMBOLS[token]] | TOKEN_EXTRA[token] << length
        bits[token] = length + TOKEN_BITS[token] if length else 0
    return words, bits


@njit(inline="always")
def _put(out, full, pending, count, word, bits):  # type: ignore[no-untyped-def]
    """Append up to 32 bits to `out`, without a branch: (its full words, the bits of the next, how many they are)."""
    pending |= word << count
    out[full] = np.uint32(pending & np.uint64(0xFFFFFFFF))
    count += bits
    ready = count >> np.uint64(5)
    return full + np.int64(ready), pending >> (ready << np.uint64(5)), count & np.uint64(31)


@njit(cache=True, nogil=True)
def _write(tokens, words, bits, header, out):  # type: ignore[no-untyped-def]
    """The fields of the header, (K, 2) values and their bits, and the tokens."""
    full, pending, count = 0, np.uint64(0), np.uint64(0)
    for field in range(header.shape[0]):
        full, pending, count = _put(out, full, pending, count, header[field, 0], header[field, 1])
    for at in range(tokens.size):
        token = tokens[at]
        full, pending, count = _put(out, full, pending, count, words[token], bits[token])
    out[full] = np.uint32(pending)
