"""Products of a table and the monomials of many trajectories in step, in tiles that stay in the processor's registers.

A product of these sizes spends its time on multiplications alone, a tenth more than the processor needs at least. A library's
is as fast, but cannot pause where the degree of the monomials rises (``columns.fill_curves``), does lanes that wait
for nothing as well, and rounds differently from one machine or number of threads to another.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numba as nb
import numpy as np
from llvmlite import binding, ir
from numba.extending import intrinsic

from softrl.core.compiled import FAST

WIDE = "avx512f" in binding.get_host_cpu_features()
WIDTH = 8 if WIDE else 4  # lanes in a register
TALL = 12 if WIDE else 6  # rows of a tile, at most: two registers a row, and some to spare
TILE = 2 * WIDTH  # lanes of a tile

_DOUBLE, _INDEX = ir.DoubleType(), ir.IntType(64)
_VECTOR = ir.VectorType(_DOUBLE, WIDTH)


class _Tile:
    """Writes the code that fills one tile of ``height`` rows."""

    def __init__(self, builder: Any, table: Any, values: Any, rows: Any, span: Sequence[Any], height: int) -> None:
        self.builder, self.table, self.values, self.rows = builder, table, values, rows
        self.row, self.lane, self.begin, self.end = span
        self.height = height

    def write(self, after: Any) -> None:
        """Write the loop over monomials from ``begin`` to ``end``, then go to the block ``after``."""
        builder = self.builder
        fresh = builder.icmp_signed("==", self.begin, _INDEX(0))
        entry, more, loop, done = (builder.block, *(builder.append_basic_block(name) for name in ("more", "loop", "done")))
        builder.cbranch(fresh, loop, more)
        builder.position_at_end(more)
        held = [builder.load(place, align=8) for place in self._places()]
        builder.branch(loop)
        builder.position_at_end(loop)
        k = builder.phi(_INDEX)
        totals = [builder.phi(_VECTOR) for _ in range(2 * self.height)]
        for block, first in ((entry, [ir.Constant(_VECTOR, [0.0] * WIDTH)] * len(totals)), (more, held)):
            k.add_incoming(self.begin, block)
            for total, value in zip(totals, first, strict=True):
                total.add_incoming(value, block)
        sums = self._sums(k, totals)
        following = builder.add(k, _INDEX(1))
        for phi, value in zip((k, *totals), (following, *sums), strict=True):
            phi.add_incoming(value, loop)
        builder.cbranch(builder.icmp_signed("<", following, self.end), loop, done)
        builder.position_at_end(done)
        for place, value in zip(self._places(), sums, strict=True):
            builder.store(value, place, align=8)
        builder.branch(after)

    def _sums(self, k: Any, totals: Sequence[Any]) -> list[Any]:
        """Return the ``totals`` with what monomial ``k`` adds."""
        builder = self.builder
        value = [builder.load(place, align=8) for place in self._pair(self.values, k)]
        start = self._at(self.table, k, self.row)
        sums = []
        for i in range(self.height):
            entry = builder.load(builder.gep(start, [_INDEX(i)]))
            wide = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), entry, ir.IntType(32)(0))
            wide = builder.shuffle_vector(wide, wide, ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH))
            for j in range(2):
                product = builder.fmul(wide, value[j], flags=("contract",))
                sums.append(builder.fadd(totals[2 * i + j], product, flags=("contract",)))
        return sums

    def _places(self) -> list[Any]:
        """Return where the tile's rows stand, two registers each."""
        return [
            place for i in range(self.height) for place in self._pair(self.rows, self.builder.add(self.row, _INDEX(i)))
        ]

    def _pair(self, array: tuple[Any, Any], row: Any) -> list[Any]:
        start = self._at(array, row, self.lane)
        places = (start, self.builder.gep(start, [_INDEX(WIDTH)]))
        return [self.builder.bitcast(place, _VECTOR.as_pointer()) for place in places]

    def _at(self, array: tuple[Any, Any], row: Any, column: Any) -> Any:
        """Return where an entry of ``array``, its data and the length of its rows, stands."""
        data, length = array
        return self.builder.gep(data, [self.builder.add(self.builder.mul(row, length), column)])


def _code(context: Any, builder: Any, signature: Any, arguments: Sequence[Any]) -> Any:
    """Write a tile of each height, and the choice among them."""
    arrays = []
    for kind, value in zip(signature.args[:3], arguments[:3], strict=True):
        array = context.make_array(kind)(context, builder, value)
        arrays.append((array.data, builder.extract_value(array.shape, 1)))
    after = builder.append_basic_block("after")
    choice = builder.switch(arguments[7], after)
    for height in range(1, TALL + 1):
        block = builder.append_basic_block(f"rows_{height}")
        choice.add_case(_INDEX(height), block)
        builder.position_at_end(block)
        _Tile(builder, *arrays, arguments[3:7], height).write(after)
    builder.position_at_end(after)
    return context.get_dummy_value()


def _fill_tile_type(
    _: Any, table: Any, values: Any, rows: Any, row: Any, lane: Any, begin: Any, end: Any, height: Any
) -> tuple[Any, Callable[..., Any]]:
    return nb.void(table, values, rows, *[nb.int64] * 5), _code


_fill_tile: Any = intrinsic(_fill_tile_type)


@nb.njit(cache=True, nogil=True, fastmath=FAST)
def multiply(table: np.ndarray, values: np.ndarray, begin: int, end: int, lanes: int, rows: np.ndarray) -> None:
    """Fill ``rows`` (m, lanes) with ``table`` (k, m) by ``values`` (k, lanes) from its row ``begin`` to ``end``.

    From any ``begin`` but 0 that is added to what is there. Only the first ``lanes`` are done, and what else is in their tiles.
    """
    m = table.shape[1]
    tiles = (m + TALL - 1) // TALL
    for lane in range(0, lanes, TILE):
        for tile in range(tiles):
            row = tile * m // tiles
            _fill_tile(table, values, rows, row, lane, begin, end, (tile + 1) * m // tiles - row)
