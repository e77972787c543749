// What the part methods search: positions by slot of the engine's grid, in one of three frames, and where cells, leaves and
// the leaves around them are.
#pragma once

#include "vdb_nns/sparse_grid.h"

#include <array>
#include <cstdint>
#include <type_traits>
#include <vector>

namespace vdb_nns::cli {

enum class AblationFrame {
    kLeafFloat,  ///< float, about the leaf's centre, in cells
    kWorldFloat, ///< float, world
    kWorldDouble ///< double, world
};

template <AblationFrame kFrame>
using FrameReal = std::conditional_t<kFrame == AblationFrame::kWorldDouble, double, float>;

constexpr std::uint32_t kNoAblationLeaf = 0xffffffffu;

struct AblationLeaf {
    std::uint64_t occupancy[8]; ///< bit y * 8 + z of word x: the cell holds a particle
    std::uint32_t firstCell[8]; ///< place in cellStart of the first occupied cell of each word
    std::uint32_t firstSlot, endSlot;
};

/// Leaves around one, (dx, dy, dz) lexicographic; kNoAblationLeaf where there is none.
using AblationNeighborhood = std::array<std::uint32_t, 27>;

/// Memory is kept when it is built anew.
template <AblationFrame kFrame>
struct AblationStructure {
    using Real = FrameReal<kFrame>;

    int reach = 1;
    double coordinateError = 0; ///< of the coordinates in cells, before they are rounded to float

    std::vector<Real> x, y, z; ///< by slot
    std::vector<std::uint32_t>
        number; ///< by slot; as the grid's, but for cells that lie at a face by rounding alone
    std::vector<AblationLeaf> leaves;
    std::vector<std::uint32_t> cellStart; ///< first slots of a leaf's occupied cells, then the leaf's end
    std::vector<AblationNeighborhood> neighborhoods;

    /// @throws std::logic_error for a grid whose cells cannot be found
    void build(const SparseGrid& grid);
    std::uint64_t bytes() const;
};

/// The leaves around each leaf.
void findNeighborhoods(const SparseGrid& grid, std::vector<AblationNeighborhood>& neighborhoods);

} // namespace vdb_nns::cli
