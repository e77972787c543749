// Where a leaf stands on a lattice of wider cells: both are counted from one corner, and an edge of the wide one is a power of two
// times the other, so that a leaf is in one leaf of the wide lattice. Any compiler.
#pragma once

#include <cstdint>

namespace vdb_nns {

struct WidePlace {
    // Cells of the leaf are 2^octaves, at least 2, times as narrow; from three octaves on one wide cell holds all of it.
    int bits; // octaves, at most 3
    // Its lowest cell from the lowest cell of the wide leaf, in units of 2^-bits wide cells.
    std::int32_t cell[3];
    // A coordinate x about the leaf's centre is scale * x + shift about the wide leaf's, in its cells.
    float scale;
    float shift[3];

    // The wide cell, 0 to 7, of a cell of the leaf.
    int wideCell(int axis, int narrowCell) const { return (cell[axis] + narrowCell) >> bits; }
};

} // namespace vdb_nns
