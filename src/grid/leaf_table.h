// The occupied leaves of one chunk of particles, found by a small hash table that grows with the leaves, not with the
// particles: on dense scenes it stays in the first-level cache. And the order of leaves over all chunks.
#pragma once

#include "vdb_nns/types.h"

#include <algorithm>
#include <cstdint>
#include <vector>

namespace vdb_nns {

inline std::uint64_t hashOfLeaf(std::int32_t x, std::int32_t y, std::int32_t z)
{
    // Odd multipliers from the golden ratio and its powers; the high bits of the sum are well mixed.
    return static_cast<std::uint64_t>(x) * 0x9E3779B97F4A7C15u +
           static_cast<std::uint64_t>(y) * 0xC2B2AE3D27D4EB4Fu +
           static_cast<std::uint64_t>(z) * 0x165667B19E3779F9u;
}

class LeafTable {
public:
    // The number in this table of the leaf at (x, y, z), in units of leaves.
    std::uint32_t numberOf(std::int32_t x, std::int32_t y, std::int32_t z)
    {
        if (2 * (mLeaves.size() + 1) > mTable.size()) grow();
        Entry& entry = place(x, y, z);
        if (entry.number == kFree) {
            entry = {x, y, z, size()};
            mLeaves.push_back({x, y, z});
            mCounts.push_back(0);
        }
        return entry.number;
    }

    void add(std::uint32_t number, std::uint32_t particles) { mCounts[number] += particles; }

    // Frees what only numberOf() needs.
    void finish() { mTable = std::vector<Entry>(); }

    std::uint64_t bytes() const
    {
        return mTable.capacity() * sizeof(Entry) + mLeaves.capacity() * sizeof(Vec3i) +
               mCounts.capacity() * sizeof(std::uint32_t);
    }

    std::uint32_t size() const { return static_cast<std::uint32_t>(mLeaves.size()); }
    const Vec3i& leaf(std::uint32_t i) const { return mLeaves[i]; }
    std::uint32_t count(std::uint32_t i) const { return mCounts[i]; }

private:
    static constexpr std::uint32_t kFree = 0xffffffffu;

    struct Entry {
        std::int32_t x, y, z;
        std::uint32_t number = kFree;
    };

    Entry& place(std::int32_t x, std::int32_t y, std::int32_t z)
    {
        const std::size_t mask = mTable.size() - 1;
        for (std::size_t h = hashOfLeaf(x, y, z) >> 32 & mask;; h = (h + 1) & mask) {
            Entry& e = mTable[h];
            if (e.number == kFree || (e.x == x && e.y == y && e.z == z)) return e;
        }
    }

    void grow()
    {
        mTable.assign(std::max<std::size_t>(256, mTable.size() * 4), Entry{0, 0, 0, kFree});
        for (std::uint32_t i = 0; i < size(); ++i) {
            place(mLeaves[i][0], mLeaves[i][1], mLeaves[i][2]) = {mLeaves[i][0], mLeaves[i][1], mLeaves[i][2],
                                                                  i};
        }
    }

    std::vector<Entry> mTable; // open addressing, a power of two
    std::vector<Vec3i> mLeaves;
    std::vector<std::uint32_t> mCounts;
};

// Turns down most leaves that touch no leaf of a grid, and none that does. Space is cut into boxes of 4^3 leaves; a bit is set for
// the hash of each box in which a leaf may touch.
class TouchFilter {
public:
    // `origins`: of the grid's leaves, in cells.
    explicit TouchFilter(const std::vector<Vec3i>& origins)
    {
        std::size_t words = 64;
        while (words * 64 < 32 * origins.size() && words < kMostWords) words *= 2;
        mBits.resize(words);
        for (const Vec3i& origin : origins) {
            std::int32_t low[3], high[3];
            for (int k = 0; k < 3; ++k) {
                low[k] = ((origin[k] >> 3) - 1) >> 2;
                high[k] = ((origin[k] >> 3) + 1) >> 2;
            }
            for (std::int32_t x = low[0]; x <= high[0]; ++x) {
                for (std::int32_t y = low[1]; y <= high[1]; ++y) {
                    for (std::int32_t z = low[2]; z <= high[2]; ++z) {
                        const std::uint64_t bit = bitOf(x, y, z);
                        mBits[bit / 64] |= std::uint64_t(1) << bit % 64;
                    }
                }
            }
        }
    }

    bool mayTouch(std::int32_t x, std::int32_t y, std::int32_t z) const
    {
        const std::uint64_t bit = bitOf(x >> 2, y >> 2, z >> 2);
        return mBits[bit / 64] >> bit % 64 & 1;
    }

private:
    static constexpr std::size_t kMostWords = std::size_t(1) << 21; // 16 MiB

    std::uint64_t bitOf(std::int32_t x, std::int32_t y, std::int32_t z) const
    {
        return hashOfLeaf(x, y, z) >> 32 & (mBits.size() * 64 - 1);
    }

    std::vector<std::uint64_t> mBits;
};

// Orders leaves by 4096^3 node, then in Morton order inside it (512^3 leaves, 9 bits an axis).
class RootOrder {
public:
    void add(const Vec3i& leaf)
    {
        const Vec3i root = rootOf(leaf);
        if (mRoots.empty() || mRoots.back() != root) mRoots.push_back(root);
    }

    void finish()
    {
        std::sort(mRoots.begin(), mRoots.end());
        mRoots.erase(std::unique(mRoots.begin(), mRoots.end()), mRoots.end());
    }

    std::uint64_t key(const Vec3i& leaf) const
    {
        const Vec3i root = rootOf(leaf);
        const auto index =
            mRoots.size() == 1 ? 0 : std::lower_bound(mRoots.begin(), mRoots.end(), root) - mRoots.begin();
        return static_cast<std::uint64_t>(index) << 27 | spread(leaf[0]) << 2 | spread(leaf[1]) << 1 |
               spread(leaf[2]);
    }

private:
    static Vec3i rootOf(const Vec3i& leaf) { return {leaf[0] >> 9, leaf[1] >> 9, leaf[2] >> 9}; }

    // Every third bit from the low 9 bits.
    static std::uint64_t spread(std::int32_t v)
    {
        std::uint64_t x = static_cast<std::uint32_t>(v) & 511;
        x = (x | x << 16) & 0x30000FF;
        x = (x | x << 8) & 0x300F00F;
        x = (x | x << 4) & 0x30C30C3;
        x = (x | x << 2) & 0x9249249;
        return x;
    }

    std::vector<Vec3i> mRoots;
};

} // namespace vdb_nns
