"""Label grids deflated from their columns, against what zlib makes of the blocks."""

import zlib

import numpy as np
import pytest
from isal import igzip_lib

from stone.labels.column_deflate import LONGEST_CODE, MOST, _code_lengths, deflated_columns
from stone.labels.columns import gathered, spread_out
from stone_base.label_grid import PAPER, RELEASE

NONE = np.zeros(PAPER.shape[:2], np.uint32)


def inflated(block):
    """The bytes of a stream that ends with its block, and with the byte that the block ends in."""
    stream = zlib.decompressobj(wbits=-15)
    found = stream.decompress(block) + stream.flush()
    assert stream.eof
    assert not stream.unused_data
    return found


def words_of(voxels):
    """The columns (256, 256) whose flat voxels of these numbers are set."""
    flat = np.zeros(PAPER.shape, np.uint8).reshape(-1)
    flat[voxels] = 1
    return gathered(flat.reshape(PAPER.shape))


@pytest.mark.parametrize("share", [0.0, 1e-5, 1e-3, 0.03, 0.5, 1.0])
def test_what_is_inflated_is_the_grid(share):
    rng = np.random.default_rng(5)
    ones, twos = (gathered(rng.uniform(size=PAPER.shape) < share) for _ in range(2))
    assert inflated(deflated_columns(ones, twos)) == spread_out(ones, twos).tobytes()
    assert inflated(deflated_columns(ones)) == spread_out(ones).tobytes()


@pytest.mark.parametrize("shape", [RELEASE.shape, (40, 24, 8), (8, 8, 16), (16, 8, 32)])
@pytest.mark.parametrize("share", [0.0, 1e-3, 0.03, 0.5, 1.0])
def test_what_is_inflated_is_the_grid_whatever_its_height(shape, share):
    rng = np.random.default_rng(7)
    grid = np.where(rng.uniform(size=shape) < share, rng.integers(1, 4, shape), 0).astype(np.uint8)
    ones, twos = gathered(grid & 1), gathered(grid & 2)
    assert (spread_out(ones, twos, height=shape[2]) == grid).all()
    assert inflated(deflated_columns(ones, twos, shape[2])) == grid.tobytes()
    assert inflated(deflated_columns(ones, height=shape[2])) == (grid & 1).tobytes()


@pytest.mark.parametrize("between", [*range(1, 5), *range(MOST - 1, MOST + 5), 2 * MOST + 1, 2 * MOST + 2, 5000])
def test_stretches_of_any_length_are_said_whole(between):
    """Between voxels that differ lie too few for a match, as many as one holds, or more by too few for another."""
    voxels = 100 + np.arange(200) * (between + 1)
    ones, twos = words_of(voxels), words_of(voxels[::3])
    assert inflated(deflated_columns(ones, twos)) == spread_out(ones, twos).tobytes()


@pytest.mark.parametrize("voxel", [0, 31, 32, 63, 2**21 - 33, 2**21 - 1])
def test_a_voxel_at_an_end_of_a_column_or_of_the_grid_is_kept(voxel):
    ones = words_of([voxel])
    assert inflated(deflated_columns(ones, NONE)) == spread_out(ones).tobytes()


def test_equal_columns_give_equal_blocks_and_half_of_what_isa_l_makes_of_ground():
    x, y, z = np.meshgrid(*map(np.arange, PAPER.shape), indexing="ij")
    rough = np.random.default_rng(6).normal(0.0, 0.05, PAPER.shape[:2])[..., None]
    height = z - (12 + 4 * np.sin(x / 40) + 3 * np.cos(y / 31) + rough)
    ground, seen = np.abs(height) < 0.7, gathered(height > 0)
    labels = gathered(ground), gathered(ground & (x % 60 > 30))
    blocks = deflated_columns(*labels), deflated_columns(seen)
    assert blocks == (deflated_columns(*labels), deflated_columns(seen))
    grids = spread_out(*labels), spread_out(seen)
    usual = sum(len(igzip_lib.compress(grid, 1, igzip_lib.COMP_DEFLATE)) for grid in grids)
    assert 2 * sum(map(len, blocks)) < usual


def test_codes_are_those_of_huffman_and_never_too_long():
    assert _code_lengths(np.array([5, 0, 9, 12, 13, 16, 45])).tolist() == [4, 0, 4, 3, 3, 3, 1]
    fibonacci = [1, 1]
    while fibonacci[-1] < 1 << 21:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    lengths = _code_lengths(np.array(fibonacci))
    assert lengths.max() <= LONGEST_CODE
    assert (0.5**lengths).sum() == 1
