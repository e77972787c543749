#include "out_of_core/block_image.h"

#include <algorithm>
#include <cstring>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kPastEnd = 16 * sizeof(float);

// Where the arrays of an image stand, in bytes from its begin.
struct ImageLayout {
    std::uint64_t leaves, occupancy, cells, x, y, z, number, cellStart, neighborhoods, bytes;
};

struct ImageSize {
    std::uint64_t ownLeaves, haloLeaves, particles, occupiedCells, partialLeaves;
};

ImageSize sizeOf(const SparseGridData& grid, const BlockPart& part)
{
    const LeafRecord &first = grid.leaves[part.firstLeaf], &end = grid.leaves[part.endLeaf];
    ImageSize size{part.endLeaf - part.firstLeaf, part.halo.size(), end.firstSlot - first.firstSlot,
                   end.firstCell - first.firstCell, part.without.size()};
    for (const CellSet& set : part.halo) {
        size.particles += particlesIn(grid, set);
        size.occupiedCells += cellsIn(set);
    }
    return size;
}

ImageLayout layoutOf(const ImageSize& size)
{
    ImageLayout layout{};
    std::uint64_t at = 0;
    const auto place = [&](std::uint64_t& offset, std::uint64_t bytes) {
        offset = at;
        at += bytes;
    };
    const std::uint64_t leaves = size.ownLeaves + size.haloLeaves;
    place(layout.leaves, (leaves + 1) * sizeof(LeafRecord));
    place(layout.occupancy, leaves * 64);
    place(layout.cells, size.partialLeaves * 64);
    place(layout.x, size.particles * 4);
    place(layout.y, size.particles * 4);
    // Vectors read up to 16 lanes past the end. What follows z must be numbers, not NaN; what follows the others may be
    // anything, and there is enough of it.
    place(layout.z, size.particles * 4 + kPastEnd);
    place(layout.number, size.particles * 4);
    place(layout.cellStart, (size.occupiedCells + 1) * 4);
    place(layout.neighborhoods, size.ownLeaves * BlockImage::kNeighborhoodSize * 4);
    layout.bytes = (at + 15) / 16 * 16;
    return layout;
}

class ImageWriter {
public:
    ImageWriter(const SparseGridData& grid, const BlockPart& part, std::byte* staging, std::byte* device)
        : mGrid(grid),
          mPart(part),
          mSize(sizeOf(grid, part)),
          mLayout(layoutOf(mSize)),
          mStaging(staging),
          mDevice(device)
    {
    }

    BlockImage write()
    {
        copyOwn();
        for (const CellSet& set : mPart.halo) copyHalo(set);
        endLeaves();
        writeNeighborhoods();
        const LeafRecord& first = mGrid.leaves[mPart.firstLeaf];
        BlockImage image{};
        image.block = {there<float>(mLayout.x),
                       there<float>(mLayout.y),
                       there<float>(mLayout.z),
                       there<std::uint32_t>(mLayout.number),
                       there<LeafRecord>(mLayout.leaves),
                       there<std::uint32_t>(mLayout.cellStart),
                       mGrid.reach()};
        image.leaves = static_cast<std::uint32_t>(mSize.ownLeaves);
        image.firstQuery = mPart.firstSlot - first.firstSlot;
        image.endQuery = mPart.endSlot - first.firstSlot;
        image.neighborhoods = there<std::uint32_t>(mLayout.neighborhoods);
        image.cells = there<std::uint64_t>(mLayout.cells);
        image.bytes = mLayout.bytes;
        return image;
    }

private:
    template <typename T>
    T* here(std::uint64_t offset) const
    {
        return reinterpret_cast<T*>(mStaging + offset);
    }
    template <typename T>
    T* there(std::uint64_t offset) const
    {
        return reinterpret_cast<T*>(mDevice + offset);
    }

    void copyParticles(std::uint32_t begin, std::uint32_t end)
    {
        const std::size_t bytes = std::size_t(end - begin) * 4;
        std::memcpy(here<float>(mLayout.x) + mSlot, mGrid.x.data() + begin, bytes);
        std::memcpy(here<float>(mLayout.y) + mSlot, mGrid.y.data() + begin, bytes);
        std::memcpy(here<float>(mLayout.z) + mSlot, mGrid.z.data() + begin, bytes);
        std::memcpy(here<std::uint32_t>(mLayout.number) + mSlot, mGrid.number.data() + begin, bytes);
        mSlot += end - begin;
    }

    void beginLeaf(const std::uint64_t* occupancy)
    {
        const std::uint64_t words = mLayout.occupancy + std::uint64_t(mLeaf) * 64;
        here<LeafRecord>(mLayout.leaves)[mLeaf++] = {mSlot, mCell, there<std::uint64_t>(words)};
        std::memcpy(here<std::uint64_t>(words), occupancy, 64);
    }

    void copyOwn()
    {
        const std::uint32_t firstSlot = mGrid.leaves[mPart.firstLeaf].firstSlot;
        std::uint32_t* const cellStart = here<std::uint32_t>(mLayout.cellStart);
        for (std::uint32_t l = mPart.firstLeaf; l < mPart.endLeaf; ++l) {
            const LeafRecord& leaf = mGrid.leaves[l];
            mSlot = leaf.firstSlot - firstSlot;
            beginLeaf(leaf.occupancy);
            for (std::uint32_t c = leaf.firstCell; c < mGrid.leaves[l + 1].firstCell; ++c) {
                cellStart[mCell++] = mGrid.cellStart[c] - firstSlot;
            }
        }
        mSlot = 0;
        copyParticles(firstSlot, mGrid.leaves[mPart.endLeaf].firstSlot);
    }

    void copyHalo(const CellSet& set)
    {
        const LeafRecord& leaf = mGrid.leaves[set.leaf];
        const std::uint32_t* cell = mGrid.cellStart.data() + leaf.firstCell;
        std::uint32_t* const cellStart = here<std::uint32_t>(mLayout.cellStart);
        beginLeaf(set.cells);
        std::uint32_t begin = 0, end = 0; // slots of the grid that are not copied yet
        for (int x = 0; x < 8; ++x) {
            for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cell) {
                if (!(set.cells[x] & word & -word)) continue;
                if (cell[0] != end) {
                    copyParticles(begin, end);
                    begin = cell[0];
                }
                cellStart[mCell++] = mSlot + (cell[0] - begin);
                end = cell[1];
            }
        }
        copyParticles(begin, end);
    }

    void endLeaves()
    {
        std::memset(here<float>(mLayout.z) + mSlot, 0, kPastEnd);
        here<LeafRecord>(mLayout.leaves)[mLeaf] = {mSlot, mCell, nullptr};
        here<std::uint32_t>(mLayout.cellStart)[mCell] = mSlot;
    }

    // The number in the image of a leaf of the grid.
    std::uint32_t leafOf(std::uint32_t leaf) const
    {
        if (leaf >= mPart.firstLeaf && leaf < mPart.endLeaf) return leaf - mPart.firstLeaf;
        if (leaf == kNoLeaf) return kNoLeaf;
        const auto set = std::lower_bound(mPart.halo.begin(), mPart.halo.end(), leaf,
                                          [](const CellSet& s, std::uint32_t l) { return s.leaf < l; });
        if (set == mPart.halo.end() || set->leaf != leaf) return kNoLeaf;
        return static_cast<std::uint32_t>(mSize.ownLeaves +
                                          static_cast<std::size_t>(set - mPart.halo.begin()));
    }

    void writeNeighborhoods()
    {
        constexpr std::uint32_t kAtOnce = 64;
        LeafNeighborhood neighborhoods[kAtOnce];
        std::uint32_t* out = here<std::uint32_t>(mLayout.neighborhoods);
        auto without = mPart.without.begin();
        std::uint32_t sets = 0;
        for (std::uint32_t l = mPart.firstLeaf; l < mPart.endLeaf;
             ++l, out += BlockImage::kNeighborhoodSize) {
            const std::uint32_t at = (l - mPart.firstLeaf) % kAtOnce;
            if (at == 0) {
                mGrid.topology.neighborhoods({&mGrid.leafOrigins[l], std::min(kAtOnce, mPart.endLeaf - l)},
                                             neighborhoods);
            }
            for (int n = 0; n < kLeavesAround; ++n) out[n] = leafOf(neighborhoods[at].leaf[n]);
            out[kLeavesAround] = kNoLeaf;
            if (without == mPart.without.end() || without->leaf != l) continue;
            std::uint64_t* const cells = here<std::uint64_t>(mLayout.cells) + std::size_t(sets) * 8;
            for (int x = 0; x < 8; ++x) cells[x] = mGrid.leaves[l].occupancy[x] & ~without->cells[x];
            out[kLeavesAround] = sets++;
            ++without;
        }
    }

    const SparseGridData& mGrid;
    const BlockPart& mPart;
    const ImageSize mSize;
    const ImageLayout mLayout;
    std::byte *const mStaging, *const mDevice;
    std::uint32_t mLeaf = 0, mSlot = 0, mCell = 0; // of the image: how many there are so far
};

} // namespace

std::uint64_t imageBytes(const SparseGridData& grid, const BlockPart& part)
{
    return layoutOf(sizeOf(grid, part)).bytes;
}

BlockImage writeImage(const SparseGridData& grid, const BlockPart& part, std::byte* staging,
                      std::byte* device)
{
    return ImageWriter(grid, part, staging, device).write();
}

} // namespace vdb_nns
